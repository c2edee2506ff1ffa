"""Entry points of other packages.

They define component kinds, FMU directories, devices and commands.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from freeflyer.foundation.errors import CosimError

RENAMED = {"cosim": "freeflyer", "fmu_src": "freeflyer_fmus", "adapters": "freeflyer_adapters"}
"""Import names of version 0.1.0, and the present import names of the same packages."""


@functools.cache
def plugins(group: str) -> Mapping[str, EntryPoint]:
    """Return the entry points of a group by name.

    The result is cached, because a scan of all installed packages takes longer than loading an FMU.
    """
    return {point.name: point for point in entry_points(group=group)}


def load(point: EntryPoint) -> Any:
    """Load the object of an entry point.

    Raises CosimError if the package of the entry point raises any exception during the import.
    """
    try:
        return point.load()
    except CosimError:
        raise
    except (Exception, SystemExit) as error:
        raise CosimError(
            f"entry point {point.name!r} ({point.group}) cannot be loaded from {point.value}: {type(error).__name__}: {error}"
            f"{renamed(error)}"
        ) from error


def renamed(error: BaseException) -> str:
    """Return the remedy for an import that failed because of a name of version 0.1.0.

    For any other exception, the result is an empty text.
    """
    old = (error.name or "").partition(".")[0] if isinstance(error, ImportError) else ""
    return (
        f"; since 0.2.0 {old} is {RENAMED[old]}: see the table in CHANGELOG.md"
        if old in RENAMED
        else ""
    )
