"""Entry points of installed packages.

With entry points, a package adds component kinds, FMU directories, devices or commands.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from freeflyer.foundation.errors import CosimError, one_line
from freeflyer.foundation.extras import needed_by

RENAMED = {"cosim": "freeflyer", "fmu_src": "freeflyer_fmus", "adapters": "freeflyer_adapters"}
"""Import names of the packages: the name in version 0.1.0 -> the name since version 0.2.0."""


@functools.cache
def plugins(group: str) -> Mapping[str, EntryPoint]:
    """Return the entry points of the group `group`. The keys are the names of the entry points.

    The result is cached, because a scan of all installed packages takes longer than loading an FMU.
    """
    return {point.name: point for point in entry_points(group=group)}


def load(point: EntryPoint, subject: str = "") -> Any:
    """Load the object of an entry point.

    Raises CosimError if the import of this object raises any exception. Raises MissingExtra if the
    object needs an extra that is not installed; `subject` is then the subject of the message.
    """
    try:
        with needed_by(subject or f"entry point {point.name!r} ({point.group})"):
            return point.load()
    except CosimError:
        raise
    except (Exception, SystemExit) as error:
        raise CosimError(
            f"entry point {point.name!r} ({point.group}) cannot be loaded from {point.value}: {described(error)}"
        ) from error


def described(error: BaseException) -> str:
    """Return the type and the message of an exception of third-party code, on one line."""
    return one_line(f"{type(error).__name__}: {error}") + renamed(error)


def renamed(error: BaseException) -> str:
    """Return the remedy for an import that failed because it uses a name of version 0.1.0.

    The caller appends the remedy to the error message. If `error` has another cause, the remedy is
    empty.
    """
    old = (error.name or "").partition(".")[0] if isinstance(error, ImportError) else ""
    return (
        f"; since 0.2.0 {old} is {RENAMED[old]}: see the table in CHANGELOG.md"
        if old in RENAMED
        else ""
    )
