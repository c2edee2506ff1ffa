"""Arrays of a record in a file that is mapped into memory.

After the death of the process, also by SIGKILL, the file has all rows up to then. The run only
writes to memory: the kernel writes the pages to the file. The disk space is reserved before the
run, so a full disk cannot stop the run.

The file consists of a line with a format number and the size of the header, the header (JSON),
and the little-endian doubles of the times and of the values. A row whose time is NaN has not been
written. The time of a row is written after its values.
"""

from __future__ import annotations

import errno
import json
import mmap
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from freeflyer.fmi.component import Array
from freeflyer.foundation import bounded_file
from freeflyer.foundation.errors import RecordError, UnusableOutput

MAGIC = b"freeflyer-rows 1"
LINE = 64
"""Length of the first line [bytes]."""
LARGEST_HEADER = 64 << 20
PAGE = 4096


def create(path: Path, header: Mapping[str, Any], rows: int, width: int) -> tuple[Array, Array]:
    """Create the file, and return its arrays: times (rows) and values (rows, width).

    Raises OutputError if the file cannot be created, or if there is not enough disk space.
    """
    text = json.dumps({**header, "rows": rows, "width": width}).encode()
    start = -(-(LINE + len(text)) // PAGE) * PAGE
    size = start + 8 * rows * (1 + width)
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        try:
            _reserve(handle, size)
            times, values = _arrays(mmap.mmap(handle, size), start, rows, width)
            times[:] = np.nan
            # The header is last: without it, the zeros of a new file are no rows.
            os.pwrite(handle, (b"%s %d\n" % (MAGIC, len(text))).ljust(LINE) + text, 0)
        finally:
            os.close(handle)
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        need = f" It needs {size / 2**30:.3g} GiB; increase [record] every_s or reduce stop_s, or choose a directory on another disk" if full else ""  # fmt: skip
        raise UnusableOutput(f"{path} for the rows of the record cannot be created: {error.strerror or error}.{need}") from error  # fmt: skip
    return times, values


def _reserve(handle: int, size: int) -> None:
    """Reserve the disk space of a file. Without a file system function, only set its size."""
    reserve = getattr(os, "posix_fallocate", None)
    if reserve is None:  # macOS
        os.ftruncate(handle, size)
    else:
        reserve(handle, 0, size)


def _arrays(buffer: Any, start: int, rows: int, width: int) -> tuple[Array, Array]:
    numbers = np.frombuffer(buffer, dtype="<f8", offset=start)
    return numbers[:rows], numbers[rows:].reshape(rows, width)


def read(path: Path) -> tuple[Mapping[str, Any], Array, Array]:
    """Return the header, and the times (n) and values (n, width) of the n written rows.

    Raises RecordError if the file is damaged. Raises OSError if it cannot be read.
    """
    with bounded_file.opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        magic, _, length = file.readline(LINE).strip().rpartition(b" ")
        if magic != MAGIC or not length.isdigit() or not int(length) <= min(size, LARGEST_HEADER):
            raise RecordError(f"{path} is not a file of rows of this version of freeflyer-cosim")
        file.seek(LINE)
        try:
            header = json.loads(file.read(int(length)))
            rows, width = header["rows"], header["width"]
            start = -(-(LINE + int(length)) // PAGE) * PAGE
            whole = type(rows) is type(width) is int and min(rows, width) >= 0
            if not whole or size != start + 8 * rows * (1 + width):
                raise ValueError
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise RecordError(f"{path} is damaged: its header and its size do not agree") from error
        buffer = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    times, values = _arrays(buffer, start, rows, width)
    written = int(np.argmax(np.isnan(times))) if np.isnan(times).any() else rows
    return header, times[:written].copy(), values[:written].copy()
