"""Reading of untrusted files: only regular files up to a size limit."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path


def content(path: Path, largest: int) -> bytes:
    """Read a file of at most `largest` bytes.

    Raises OSError, with the reason in `strerror`, if it is no regular file or is larger.
    """
    try:
        # The open call must not block on a FIFO without a writer or on a terminal.
        descriptor = os.open(
            path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
        )
    except ValueError as error:  # a name with a NUL character
        raise OSError(errno.EINVAL, "no file can have this name") from error
    with open(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "it is no regular file")
        data = file.read(largest + 1)
    if len(data) > largest:
        raise OSError(errno.EFBIG, f"it has more than {size(largest)}")
    return data


def size(count: int) -> str:
    """Format a number of bytes, for messages."""
    for unit, bits in (("GiB", 30), ("MiB", 20), ("KiB", 10)):
        if count >= 1 << bits:
            return f"{count / (1 << bits):.4g} {unit}"
    return f"{count} bytes"
