"""Private directories for sockets, ring buffers and files. Other users have no access."""

from __future__ import annotations

import os
from pathlib import Path


def made(path: Path) -> str | None:
    """Make a directory with mode 0700. An existing directory is not changed.

    Returns None if the directory may be used, or the reason why the directory must not be used.
    """
    try:
        path.mkdir(mode=0o700, exist_ok=True)
        state = path.lstat()
    except OSError as error:
        return f"{path} cannot be made: {error.strerror}"
    if path.is_symlink() or state.st_uid != os.getuid() or state.st_mode & 0o077:
        return f"{path} is not private to this user; a directory of this user with mode 0700 is expected"
    return None
