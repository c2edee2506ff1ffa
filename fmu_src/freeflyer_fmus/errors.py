"""What can go wrong between a URDF and an FMU; every message is one sentence for the user."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class FmuSourceError(Exception):
    """Base of this package's errors."""


class RobotError(FmuSourceError):
    """A robot description that is broken or physically impossible."""


class BlockError(FmuSourceError):
    """A block whose variables and equations do not fit each other."""


class BuildError(FmuSourceError):
    """The C compiler or the packaging failed."""


def did_you_mean(name: str, candidates: Iterable[str]) -> str:
    """'; did you mean NAME?' where a known name is near."""
    close = difflib.get_close_matches(name, list(candidates), n=1)
    return f"; did you mean {close[0]!r}?" if close else ""


RENAMED = {"fmu_src": "freeflyer_fmus", "cosim": "freeflyer", "adapters": "freeflyer_adapters"}
"""Import names of 0.1.0."""


def renamed(error: BaseException) -> str:
    """The remedy for an import that failed because it uses a name of 0.1.0; empty for any other error."""
    old = (error.name or "").partition(".")[0] if isinstance(error, ImportError) else ""
    return f"; since 0.2.0 {old} is {RENAMED[old]}: see the table in CHANGELOG.md" if old in RENAMED else ""
