"""Extensions of other packages: component kinds, FMU directories, virtual devices and commands, found through entry points."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from freeflyer.foundation.errors import CosimError

RENAMED = {"cosim": "freeflyer", "fmu_src": "freeflyer_fmus", "adapters": "freeflyer_adapters"}
"""Import names of 0.1.0."""


@functools.cache
def plugins(group: str) -> Mapping[str, EntryPoint]:
    """Entry points by name. Cached: looking through every installed package takes longer than loading an FMU."""
    return {point.name: point for point in entry_points(group=group)}


def load(point: EntryPoint) -> Any:
    """Load what an entry point names. Raises CosimError in one sentence, whatever its package raises."""
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
    """The remedy for an import that failed because it uses a name of 0.1.0; empty for any other error."""
    old = (error.name or "").partition(".")[0] if isinstance(error, ImportError) else ""
    return (
        f"; since 0.2.0 {old} is {RENAMED[old]}: see the table in CHANGELOG.md"
        if old in RENAMED
        else ""
    )
