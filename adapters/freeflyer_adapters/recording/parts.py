"""Parts of a long recording: `recording.mcap`, `recording_2.mcap`, and so on.

Each part is a complete MCAP file. The mcap writer keeps an index of all chunks of a file in memory,
and writes this index at the end of the file. Therefore a new part is started before the index is
large.
"""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.records import Metadata

from freeflyer_adapters.recording.damaged_mcap import DamagedMcap, WholeMessage
from freeflyer_adapters.recording.mcap_file import (
    CHUNK_SECONDS,
    MESSAGE_OVERHEAD,
    RECORDING,
    RUN,
    STARTED,
    RecordingFile,
    chosen,
    save,
    stop_of,
)
from freeflyer_adapters.recording.ring import RingReader, Rows
from freeflyer_adapters.recording.ring_header import RecordingHeader
from freeflyer_adapters.recording.topics import topics

PART_SECONDS = 300.0
"""Length of a part in real time [s].

The index grows by some MiB per minute. With 26 topics, it takes 0.08 to 0.15 s to write the index.
During this time the recorder reads no CAN frame. But the sockets lose no frame, because their
buffers have space for the frames of 0.3 s (loop at 1 kHz)."""
NEXT = "freeflyer.next"
"""Name of the metadata at the end of every part except the last part.

This metadata contains the file name of the next part."""
PART = re.compile(rf"{Path(RECORDING).stem}_([1-9][0-9]{{0,5}})\.mcap")


def part(directory: Path, number: int) -> Path:
    """Return the path of part `number`, counted from 1."""
    first = directory / RECORDING
    return first if number == 1 else first.with_name(f"{first.stem}_{number}{first.suffix}")


def parts(directory: Path) -> list[Path]:
    """Return the existing parts of a recording, in order."""
    found = {}
    for path in directory.iterdir():
        matched = PART.fullmatch(path.name)
        if matched is not None or path.name == RECORDING:
            found[int(matched[1]) if matched is not None else 1] = path
    return [found[number] for number in sorted(found)]


class PartedRecording:
    """Writer of a recording that consists of parts. All methods raise OSError for disk errors."""

    def __init__(self, head: RecordingHeader) -> None:
        self._head, self._signals = head, chosen(head)
        self._directory = Path(head.directory)
        self._directory.mkdir(parents=True, exist_ok=True)
        self._rows = max(1, round(PART_SECONDS * 1e9 / head.tick))
        self.paths: list[Path] = []
        self._file = self._next()

    def _next(self) -> RecordingFile:
        path = part(self._directory, len(self.paths) + 1)
        self._stream = stream = path.open("wb")
        file = RecordingFile(stream, self._head, self._signals, CHUNK_SECONDS)
        file.flush()
        self._identity, self._left = os.fstat(stream.fileno()), self._rows
        self.paths.append(path)
        return file

    def add(self, rows: Rows) -> None:
        """Add rows. Start the next part when the present part is full."""
        while len(rows):
            if not self._left:
                self._change()
            now, rows = rows.split(self._left)
            self._file.add(now)
            self._left -= len(now)

    def _change(self) -> None:
        """Start the next part, then finish the previous part.

        If the run is killed between these two actions, both parts are unfinished. In the reverse
        order, all existing parts would be complete, and the recording would seem to be complete.
        """
        with self._stream:
            before, self._file = self._file, self._next()
            before.end({"file": self.paths[-1].name}, NEXT)

    def flush(self) -> None:
        """Flush complete chunks.

        If the file was deleted or replaced, all further data would be lost. Therefore this method
        also raises OSError in this case.
        """
        self._file.flush()
        found = os.stat(self.paths[-1])
        if (found.st_dev, found.st_ino) != (self._identity.st_dev, self._identity.st_ino):
            raise OSError(0, f"{self.paths[-1]} has been replaced by another file")

    def finish(self, stop: Mapping[str, str]) -> None:
        """Finish the last part with the reason of the stop."""
        with self._stream:
            self._file.finish(stop)


def started(path: Path) -> str | None:
    """Return the start of the run from the metadata of a part, or None if it is missing."""
    try:
        with path.open("rb") as file:
            for record in DamagedMcap(file).records():
                if isinstance(record, Metadata) and record.name == RUN:
                    return record.metadata.get(STARTED)
                if isinstance(record, WholeMessage):
                    break
    except OSError:
        pass
    return None


def save_rest(ring: RingReader, recorder: str, clock_steps: Sequence[str] = ()) -> Path | None:
    """Write a further part with the rows that are in the ring but not in the recording.

    Return the path of this part. Return None if no row is missing, or if the run is not recorded.
    `recorder`, `clock_steps`: see `stop_of`. Raises OutputError if the part cannot be written.
    """
    head = ring.head
    rows = ring.everything()
    if not head.records or not len(rows):
        return None
    directory = Path(head.directory)
    there = parts(directory) if directory.is_dir() else []
    ours = [path for path in there if started(path) == str(head.started)]
    # For each instant in the ring, find the topics that are missing in the last two parts.
    made = topics(head, chosen(head))
    # Search this number of bytes at the end of a part for these rows. The number is sufficient,
    # because compression makes the rows smaller.
    enough = (len(rows) + 1000) * sum(topic.layout.size + MESSAGE_OVERHEAD for topic in made)
    has = _recorded(ours[-2:], set(rows.times[:, 0].tolist()), enough)
    every = {topic.name for topic in made}
    absent = [every - has[time] for time in rows.times[:, 0].tolist()]
    if not any(absent):
        return None

    def write(stream: BinaryIO) -> None:
        file = RecordingFile(stream, head, chosen(head), CHUNK_SECONDS)
        whole = np.array([names == every for names in absent])
        for i in np.flatnonzero([bool(names) and names != every for names in absent]):
            # The last chunk in the recording ended in the middle of this instant.
            file.add(rows.where(np.arange(len(rows)) == i), absent[i])
        file.add(rows.where(whole))
        file.finish(stop_of(ring, recorder, clock_steps))

    # Do not add a part to the recording of another run. Use a file with another name instead.
    if len(ours) == len(there):
        return save(part(directory, number_of(there[-1]) + 1 if there else 1), write)
    return save(directory / f"{Path(RECORDING).stem}_of_{head.started}_rest.mcap", write)


def number_of(path: Path) -> int:
    """Return the number of a part."""
    matched = PART.fullmatch(path.name)
    return 1 if matched is None else int(matched[1])


def _recorded(paths: list[Path], times: set[int], tail: int) -> dict[int, set[str]]:
    """Return the topics that are already recorded for each of the times `times`.

    A time is the wall time of a row [ns since the epoch]. Only the last `tail` bytes of each part
    are searched.
    """
    found: dict[int, set[str]] = defaultdict(set)
    for path in paths:
        with path.open("rb") as file:
            for record in DamagedMcap(file).records(tail):
                if isinstance(record, WholeMessage) and record.log_time in times:
                    found[record.log_time].add(record.channel.topic)
    return found
