"""The last seconds of a loop in memory that outlives it: one row for every instant, in a file of the user's runtime directory or /dev/shm.

The loop only copies numbers; there is no lock, no system call and nothing that grows. The file is a page with the numbers below, the
run's head as JSON, and the rows. A row is [number + 1, wall time (ns), monotonic clock (ns), instant k], the values, and once more
number + 1: zero while the row is being written, so that nobody takes a torn one. (Stores are seen in order on x86; on other
processors the second number narrows the gap but does not close it.) The wall time is the monotonic clock and one
offset, the head's `clock_offset` if it has one, so that it does not jump when the wall clock is set; in rings of earlier versions it is
the wall clock of that moment.

Everybody who works on a ring holds a shared lock on its file, which goes with its process, however that ends: a ring whose lock is
free has been left behind.
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
from freeflyer_adapters.recording.header import RecordingHeader
from freeflyer_adapters.recording.wall_clock import offset_of

MAGIC = b"FFRING1\n"
FIXED = struct.Struct("<8sQQQQ")
"""Magic, rows, values of a row, bytes of the JSON head, where the first row begins."""
WRITTEN = struct.Struct("<Q")
"""How many rows were ever written, in a place of its own; behind it, the number of bytes of the reason to stop, then the reason."""
WRITTEN_AT, REASON_AT, LONGEST_REASON = 64, 72, 2000
PAGE = 4096
TIMES = 4
"""Words before a row's values; one more follows them."""
SECONDS = 8.0
LARGEST = 256 * 2**20
"""Bytes of all rows."""
MOST_WRITTEN = 2**60
"""Rows: some million years at 1 kHz; the numbers of rows stay within 64 bits with a sign."""


@dataclass(frozen=True)
class Rows:
    """`times` (rows, 3): wall time, monotonic clock [ns], instant; `values` (rows, width)."""

    times: NDArray[np.int64]
    values: Array

    def __len__(self) -> int:
        return len(self.times)

    def where(self, chosen: NDArray[np.bool_]) -> Rows:
        return Rows(self.times[chosen], self.values[chosen])

    def split(self, count: int) -> tuple[Rows, Rows]:
        """The first ones, and the others."""
        return Rows(self.times[:count], self.values[:count]), Rows(
            self.times[count:], self.values[count:]
        )

    @staticmethod
    def none(width: int) -> Rows:
        return Rows(np.zeros((0, 3), dtype=np.int64), np.zeros((0, width)))


def folder() -> Path:
    """Where rings are: private to the user. RecordError if that cannot be had."""
    chosen = os.environ.get("XDG_RUNTIME_DIR") or (
        "/dev/shm" if os.access("/dev/shm", os.W_OK) else tempfile.gettempdir()
    )
    path = Path(chosen) / f"freeflyer-rings-{os.getuid()}"
    if refused := private_directory.made(path):
        raise RecordError(f"the directory of rings {refused}")
    return path


class RingWriter:
    """The loop's side."""

    def __init__(self, head: RecordingHeader, directory: Path | None = None) -> None:
        """RecordError if there is no room: the memory is all there from the begin, so that no write can fail."""
        text = head.to_json()
        self.width = head.width
        row_bytes = 8 * (TIMES + self.width + 1)
        self.rows = max(64, min(round(SECONDS * 1e9 / head.tick), LARGEST // row_bytes))
        first = PAGE + -(-len(text) // PAGE) * PAGE
        size = first + self.rows * row_bytes
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
                f"the ring of {size / 2**20:.1f} MiB for the recording cannot be made in {self.path.parent}: {error.strerror}"
            ) from error
        self._lock = handle
        self._memory[PAGE : PAGE + len(text)] = text
        words = np.frombuffer(self._memory, dtype="<i8", offset=first).reshape(self.rows, -1)
        self._words, self._values = words, words.view("<f8")[:, TIMES:-1]
        self._written = np.frombuffer(self._memory, dtype="<u8", count=1, offset=WRITTEN_AT)
        self._count = 0
        self._environment = environment.present()
        self._offset = (
            offset_of(self._environment) if head.clock_offset is None else head.clock_offset
        )
        # The magic last: a file without it is no ring yet.
        self._memory[: FIXED.size] = FIXED.pack(MAGIC, self.rows, self.width, len(text), first)

    def write(self, k: int, line: Array) -> None:
        """`line` (width) at instant k, stamped with this moment."""
        count = self._count
        row = self._words[count % self.rows]
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
        """-1 before the first row."""
        return int(self._words[(self._count - 1) % self.rows][3]) if self._count else -1

    def say_reason(self, reason: str) -> None:
        """Why the loop has ended; rows that follow are not expected."""
        text = reason.encode(errors="replace")[:LONGEST_REASON]
        self._memory[REASON_AT + 8 : REASON_AT + 8 + len(text)] = text
        self._memory[REASON_AT : REASON_AT + 8] = WRITTEN.pack(len(text))

    def close(self) -> None:
        """Lets go of the ring; its file stays."""
        if self._lock >= 0:
            fcntl.flock(self._lock, fcntl.LOCK_UN)  # the memory map has a descriptor of its own
            os.close(self._lock)
            self._lock = -1


class RingReader:
    """Whoever follows a ring, or saves one that was left behind. RecordError for a file that is no ring."""

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
            raise RecordError(f"{self.path} is no ring of a loop: it has {size} bytes")
        self._memory = mmap.mmap(self._lock, size, access=mmap.ACCESS_READ)
        magic, rows, width, length, first = FIXED.unpack_from(self._memory, 0)
        if magic != MAGIC:
            raise RecordError(f"{self.path} is no ring of a loop: it begins with {magic!r}")
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
                f"{self.path} is a damaged ring: its rows have {width} values, its head {self.head.width}"
            )
        if self.written > MOST_WRITTEN:
            raise RecordError(
                f"{self.path} is a damaged ring: nobody has written {self.written} rows"
            )
        self.rows = rows
        words = np.frombuffer(
            self._memory, dtype="<i8", offset=first, count=rows * (TIMES + width + 1)
        )
        self._words = words.reshape(rows, -1)
        self.next = 0
        """The number of the first row not taken yet."""
        self.lost = 0
        """Rows that were written over before they were taken."""

    @property
    def written(self) -> int:
        return int(WRITTEN.unpack_from(self._memory, WRITTEN_AT)[0])

    @property
    def reason(self) -> str | None:
        """Why the loop ended, in its own words; None if it has said nothing."""
        (length,) = WRITTEN.unpack_from(self._memory, REASON_AT)
        place = REASON_AT + 8
        return (
            self._memory[place : place + length].decode(errors="replace")
            if 0 < length <= LONGEST_REASON
            else None
        )

    def take(self, most: int) -> Rows:
        """The next whole rows, oldest first; what was written over meanwhile is counted."""
        written = self.written
        # Keep away from the row that is written over next.
        oldest = max(0, written - self.rows + 1)
        if self.next < oldest:
            self.lost += oldest - self.next
            self.next = oldest
        last = min(written, self.next + most)
        if self.next >= last:
            return Rows.none(self.head.width)
        numbers = np.arange(self.next, last)
        taken = self._words[numbers % self.rows]  # a copy
        again = self._words[numbers % self.rows, 0]
        whole = (
            (taken[:, 0] == numbers + 1) & (taken[:, -1] == numbers + 1) & (again == numbers + 1)
        )
        whole &= (taken[:, 1:TIMES] >= 0).all(axis=1)  # a file has no negative times
        self.lost += int((~whole).sum())
        self.next = last
        taken = taken[whole]
        return Rows(taken[:, 1:TIMES], taken[:, TIMES:-1].view("<f8"))

    def last(self, seconds: float) -> Rows:
        """Every whole row of the last seconds before the newest one [s of the monotonic clock]."""
        rows = self.everything()
        if not len(rows):
            return rows
        return rows.where(rows.times[:, 1] >= rows.times[-1, 1] - round(seconds * 1e9))

    def everything(self) -> Rows:
        """Every whole row that is there, taken before or not."""
        at, lost = self.next, self.lost
        self.next = max(0, self.written - self.rows + 1)
        rows = self.take(self.rows)
        self.next, self.lost = at, lost
        return rows

    def close(self) -> None:
        if self._lock >= 0:
            fcntl.flock(self._lock, fcntl.LOCK_UN)  # the memory map has a descriptor of its own
            os.close(self._lock)
            self._lock = -1

    def remove(self) -> None:
        self.path.unlink(missing_ok=True)
        self.close()


def is_left_behind(path: Path) -> bool:
    """Whether nobody works on the ring any more."""
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
    """Rings of loops that have died together with their recorders."""
    with contextlib.suppress(RecordError):
        for path in sorted((directory or folder()).glob("*.ring")):
            if is_left_behind(path):
                yield path
