"""Reader for untrusted files. It accepts only regular files up to a size limit."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Open a regular file for reading.

    Raises OSError if the file cannot be opened or is not a regular file. The attribute `strerror`
    of the exception contains the reason.
    """
    # Without O_NONBLOCK, `open` would wait if the path is a FIFO without a writer. Without
    # O_NOCTTY, a terminal could become the controlling terminal of this process.
    more = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
    try:
        handle = os.open(path, os.O_RDONLY | more)
    except ValueError as error:  # the name contains a NUL character
        raise OSError(errno.EINVAL, "no file can have this name") from error
    with os.fdopen(handle, "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file")
        yield file


def content(path: Path, largest: int) -> bytes:
    """Return the content of a regular file of at most `largest` bytes.

    Raises OSError as `opened` does, and if the file has more than `largest` bytes.
    """
    with opened(path) as file:
        data = file.read(largest + 1)
    if len(data) > largest:
        raise OSError(errno.EFBIG, f"it has more than {size(largest)}")
    return data


def size(count: int) -> str:
    """Format a number of bytes for a message."""
    for unit, bits in (("GiB", 30), ("MiB", 20), ("KiB", 10)):
        if count >= 1 << bits:
            return f"{count / (1 << bits):.4g} {unit}"
    return f"{count} bytes"
