"""Caches of zig and Matplotlib if the home directory cannot be written.

Services and containers often have no home directory. zig then fails, and Matplotlib warns.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

_temporary: list[object] = []


def cache_of_zig() -> str:
    """Return zig's global cache directory. Raises CosimError if no directory can be written."""
    return (
        os.environ.get("ZIG_GLOBAL_CACHE_DIR")
        or _writable("XDG_CACHE_HOME", ".cache", "zig")
        or _kept()
    )


def give_matplotlib_a_folder() -> None:
    """Set MPLCONFIGDIR if Matplotlib has no folders for its configuration and its cache."""
    if "MPLCONFIGDIR" not in os.environ and not (
        _writable("XDG_CONFIG_HOME", ".config", "matplotlib")
        and _writable("XDG_CACHE_HOME", ".cache", "matplotlib")
    ):
        os.environ["MPLCONFIGDIR"] = _kept()


def _writable(variable: str, default: str, name: str) -> str | None:
    """Return the folder `name` in `$variable`, or else in `~/default`, if it can be written."""
    place = Path(os.environ.get(variable) or Path(os.path.expanduser("~"), default))
    found = folder = place / name
    while not found.exists() and found != place.parent:
        found = found.parent
    try:
        if found != folder:  # `os.access` alone accepts /proc
            probe = found / f".freeflyer-{os.getpid()}"
            probe.mkdir()
            probe.rmdir()
    except OSError:
        return None
    return str(folder) if os.access(found, os.W_OK | os.X_OK) else None


@cache
def _kept() -> str:
    """Return the folder of all caches without a place. It exists until the process ends."""
    from freeflyer.foundation.temporary_folder import TemporaryFolder  # only if it is needed

    _temporary.append(folder := TemporaryFolder())
    return str(folder.path)
