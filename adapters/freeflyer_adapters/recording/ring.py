"""Ring buffer in shared memory. It contains the last seconds of a loop.

An instant is a point in time at which the loop computes. The loop writes one row for every instant.

The buffer is a file in the user's runtime directory or in /dev/shm. The file remains when the loop
ends. A write only copies numbers. It needs no lock, no system call and no allocation.

The file contains a page with fixed numbers (`FIXED`, `WRITTEN`), the recording header as JSON, and
the rows. The rows are numbered from 0. A row contains, in this order:

- the number of the row plus 1, the wall time [ns], the monotonic clock [ns] and the instant k
- the values
- the number of the row plus 1 again

While a row is being written, both copies of its number are zero. So a reader can reject a row that
is only partly written. This check is reliable on x86: there, other processes see the memory writes
in the order in which the program makes them. On other processors, this order may change, so a
reader could accept a partly written row. The second copy makes this unlikely.

The wall time is the monotonic clock plus a constant offset, `clock_offset` in the header.
Therefore the wall time does not jump when the wall clock is set. Rings of earlier versions contain
the wall clock itself.

Every process that uses a ring holds a shared lock on the file of the ring. The lock of a process
ends with this process. If no process holds a lock, no process uses the ring any more.
"""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
import struct
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from freeflyer.fmi.component import Array
from freeflyer.foundation.errors import RecordError
from freeflyer_adapters.foundation import environment, private_directory
from freeflyer_adapters.recording.ring_header import RecordingHeader
from freeflyer_adapters.recording.wall_clock import offset_of

MAGIC = b"FFRING1\n"
FIXED = struct.Struct("<8sQQQQ")
"""Magic bytes, number of rows, values per row, size of the JSON header, offset of the first row."""
WRITTEN = struct.Struct("<Q")
"""Total number of written rows.

The reason of the stop follows this number: first the size of the text, then the text."""
WRITTEN_AT, REASON_AT, LONGEST_REASON = 64, 72, 2000
PAGE = 4096
TIMES = 4
"""Number of 64-bit integers before the values of a row. One 64-bit integer follows the values."""
SECONDS = 8.0
LARGEST = 256 * 2**20
"""Maximum size of all rows [bytes]."""
MOST_WRITTEN = 2**60
"""Maximum number of written rows, so that row numbers fit into signed 64-bit integers."""


@dataclass(frozen=True)
class Rows:
    """Rows of a ring.

    `times` (rows, 3): wall time [ns], monotonic clock [ns] and instant of each row. `values`
    (rows, width): values of each row.
    """

    times: NDArray[np.int64]
    values: Array

    def __len__(self) -> int:
        return len(self.times)

    def where(self, chosen: NDArray[np.bool_]) -> Rows:
        """Return the rows that the mask `chosen` (rows) selects."""
        return Rows(self.times[chosen], self.values[chosen])

    def split(self, count: int) -> tuple[Rows, Rows]:
        """Return the first `count` rows, and the remaining rows."""
        return Rows(self.times[:count], self.values[:count]), Rows(
            self.times[count:], self.values[count:]
        )

    @staticmethod
    def none(width: int) -> Rows:
        """Return an empty object for rows of `width` values."""
        return Rows(np.zeros((0, 3), dtype=np.int64), np.zeros((0, width)))


def folder() -> Path:
    """Return the user's private directory of rings.

    Raises RecordError if this directory cannot be created.
    """
    chosen = os.environ.get("XDG_RUNTIME_DIR") or (
        "/dev/shm" if os.access("/dev/shm", os.W_OK) else tempfile.gettempdir()
    )
    path = Path(chosen) / f"freeflyer-rings-{os.getuid()}"
    if refused := private_directory.made(path):
        raise RecordError(f"the directory of rings {refused}")
    return path


class RingWriter:
    """Writer of a ring, for the loop."""

    def __init__(self, head: RecordingHeader, directory: Path | None = None) -> None:
        """Allocate the whole ring, so that no later write can fail.

        Raises RecordError if there is not enough memory.
        """
        # The header fills whole pages. The rows fill at most `LARGEST` bytes.
        text = head.to_json()
        self.width = head.width
        row_bytes = 8 * (TIMES + self.width + 1)
        self.rows = max(64, min(round(SECONDS * 1e9 / head.tick), LARGEST // row_bytes))
        first = PAGE + -(-len(text) // PAGE) * PAGE
        size = first + self.rows * row_bytes
        # Lock the file before its memory is reserved. Otherwise another process could remove the
        # file, because a file without a lock counts as the ring of an ended run.
        handle, name = tempfile.mkstemp(
            prefix=f"{os.getpid()}-", suffix=".ring", dir=directory or folder()
        )
        self.path = Path(name)
        try:
            fcntl.flock(handle, fcntl.LOCK_SH)
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(handle, 0, size)
            else:  # macOS
                for _ in range(-(-size // 2**20)):
                    os.write(handle, bytes(2**20))
            self._memory = mmap.mmap(
                handle, size, flags=mmap.MAP_SHARED | getattr(mmap, "MAP_POPULATE", 0)
            )
        except OSError as error:
            os.close(handle)
            self.path.unlink(missing_ok=True)
            raise RecordError(
                f"the ring of {size / 2**20:.1f} MiB for the recording cannot be created in {self.path.parent}: {error.strerror}"
            ) from error
        # Views of the rows as integers and as floats.
        self._lock = handle
        self._memory[PAGE : PAGE + len(text)] = text
        integers = np.frombuffer(self._memory, dtype="<i8", offset=first).reshape(self.rows, -1)
        self._integers, self._values = integers, integers.view("<f8")[:, TIMES:-1]
        self._written = np.frombuffer(self._memory, dtype="<u8", count=1, offset=WRITTEN_AT)
        self._count = 0
        self._environment = environment.present()
        self._offset = (
            offset_of(self._environment) if head.clock_offset is None else head.clock_offset
        )
        # Write the magic bytes last. Without the magic bytes the file is not a valid ring.
        self._memory[: FIXED.size] = FIXED.pack(MAGIC, self.rows, self.width, len(text), first)

    def write(self, k: int, line: Array) -> None:
        """Write the values `line` (width) as the row of instant `k`, with the present time."""
        count = self._count
        row = self._integers[count % self.rows]
        row[0] = row[-1] = 0
        row[2] = now = self._environment.monotonic_ns()
        row[1] = now + self._offset
        row[3] = k
        self._values[count % self.rows] = line
        self._count = count = count + 1
        row[0] = row[-1] = count
        self._written[0] = count

    @property
    def last_instant(self) -> int:
        """Instant of the last row, or -1 if there is no row."""
        return int(self._integers[(self._count - 1) % self.rows][3]) if self._count else -1

    def set_reason(self, reason: str) -> None:
        """Store the reason of the stop. Do not write rows after this call."""
        text = reason.encode(errors="replace")[:LONGEST_REASON]
        self._memory[REASON_AT + 8 : REASON_AT + 8 + len(text)] = text
        self._memory[REASON_AT : REASON_AT + 8] = WRITTEN.pack(len(text))

    def close(self) -> None:
        """Release the lock. The file remains."""
        if self._lock >= 0:
            # Unlock explicitly. `os.close` alone does not release the lock, because the memory map
            # has a descriptor of the file, too.
            fcntl.flock(self._lock, fcntl.LOCK_UN)
            os.close(self._lock)
            self._lock = -1


class RingReader:
    """Reader of a ring. Raises RecordError if the file is not a valid ring."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._lock = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
        except OSError as error:
            raise RecordError(f"{path} cannot be read: {error.strerror}") from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_SH)
            self._open(os.fstat(self._lock).st_size)
        except BaseException:
            self.close()
            raise

    def _open(self, size: int) -> None:
        if size < PAGE:
            raise RecordError(
                f"{self.path} is not a ring of a loop: it has {size} bytes, at least {PAGE} are expected"
            )
        self._memory = mmap.mmap(self._lock, size, access=mmap.ACCESS_READ)
        magic, rows, width, length, first = FIXED.unpack_from(self._memory, 0)
        if magic != MAGIC:
            raise RecordError(
                f"{self.path} is not a ring of a loop: it starts with {magic!r}, {MAGIC!r} is expected"
            )
        fits = (
            PAGE + length <= first
            and first % 8 == 0
            and rows
            and first + rows * 8 * (TIMES + width + 1) <= size
        )
        if not fits:
            raise RecordError(
                f"{self.path} is a damaged ring: {rows} rows of {width} values do not fit into {size} bytes"
            )
        self.head = RecordingHeader.from_json(self._memory[PAGE : PAGE + length])
        if self.head.width != width:
            raise RecordError(
                f"{self.path} is a damaged ring: its rows have {width} values, but its header describes {self.head.width} values"
            )
        if self.written > MOST_WRITTEN:
            raise RecordError(
                f"{self.path} is a damaged ring: {self.written} is not a possible number of written rows"
            )
        self.rows = rows
        integers = np.frombuffer(
            self._memory, dtype="<i8", offset=first, count=rows * (TIMES + width + 1)
        )
        self._integers = integers.reshape(rows, -1)
        self.next = 0
        """Number of the next row to read."""
        self.lost = 0
        """Number of rows that were overwritten before they were read."""

    @property
    def written(self) -> int:
        """Total number of rows that the loop has written."""
        return int(WRITTEN.unpack_from(self._memory, WRITTEN_AT)[0])

    @property
    def reason(self) -> str | None:
        """Reason of the stop that the loop has stored, or None if it has stored no reason."""
        (length,) = WRITTEN.unpack_from(self._memory, REASON_AT)
        place = REASON_AT + 8
        return (
            self._memory[place : place + length].decode(errors="replace")
            if 0 < length <= LONGEST_REASON
            else None
        )

    def take(self, most: int) -> Rows:
        """Return the next intact rows, the oldest row first. Read at most `most` rows.

        The number of rows that were overwritten before they were read is added to `lost`.
        """
        written = self.written
        # Do not read the oldest row in the ring, because it is overwritten next.
        oldest = max(0, written - self.rows + 1)
        if self.next < oldest:
            self.lost += oldest - self.next
            self.next = oldest
        last = min(written, self.next + most)
        if self.next >= last:
            return Rows.none(self.head.width)
        numbers = np.arange(self.next, last)
        taken = self._integers[numbers % self.rows]  # this is a copy
        again = self._integers[numbers % self.rows, 0]
        whole = (
            (taken[:, 0] == numbers + 1) & (taken[:, -1] == numbers + 1) & (again == numbers + 1)
        )
        whole &= (taken[:, 1:TIMES] >= 0).all(axis=1)  # a valid ring has no negative times
        self.lost += int((~whole).sum())
        self.next = last
        taken = taken[whole]
        return Rows(taken[:, 1:TIMES], taken[:, TIMES:-1].view("<f8"))

    def last(self, seconds: float) -> Rows:
        """Return the intact rows that are at most `seconds` [s] older than the newest row."""
        rows = self.everything()
        if not len(rows):
            return rows
        return rows.where(rows.times[:, 1] >= rows.times[-1, 1] - round(seconds * 1e9))

    def everything(self) -> Rows:
        """Return all intact rows in the ring, including rows that were already read."""
        at, lost = self.next, self.lost
        self.next = max(0, self.written - self.rows + 1)
        rows = self.take(self.rows)
        self.next, self.lost = at, lost
        return rows

    def close(self) -> None:
        """Release the lock. The file remains."""
        if self._lock >= 0:
            # Unlock explicitly. `os.close` alone does not release the lock, because the memory map
            # has a descriptor of the file, too.
            fcntl.flock(self._lock, fcntl.LOCK_UN)
            os.close(self._lock)
            self._lock = -1

    def remove(self) -> None:
        """Delete the file and release the lock."""
        self.path.unlink(missing_ok=True)
        self.close()


def is_left_behind(path: Path) -> bool:
    """Return whether no process uses the ring any more."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    finally:
        os.close(handle)
    return True


def left_behind(directory: Path | None = None) -> Iterator[Path]:
    """Yield the rings of runs whose loop and recorder have ended."""
    with contextlib.suppress(RecordError):
        for path in sorted((directory or folder()).glob("*.ring")):
            if is_left_behind(path):
                yield path
