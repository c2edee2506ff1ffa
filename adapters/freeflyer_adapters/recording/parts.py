"""A long recording's parts: `recording.mcap`, `recording_2.mcap`, ..., each a whole file.

mcap's writer keeps the index of every chunk until its file is finished, and readers want that index; so a file ends before it is large.
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
from freeflyer_adapters.recording.header import RecordingHeader
from freeflyer_adapters.recording.recording_file import (
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
from freeflyer_adapters.recording.topics import topics

PART_SECONDS = 300.0
"""Of a loop in time: the index grows by some MiB a minute, and at the end of a part it is written in 0.08 to 0.15 s (26 topics), in
which nobody listens to the CAN channels, whose sockets hold 0.3 s at 1 kHz."""
NEXT = "freeflyer.next"
"""Metadata at the end of a part that is not the last: which one follows."""
PART = re.compile(rf"{Path(RECORDING).stem}_([1-9][0-9]{{0,5}})\.mcap")


def part(directory: Path, number: int) -> Path:
    first = directory / RECORDING
    return first if number == 1 else first.with_name(f"{first.stem}_{number}{first.suffix}")


def parts(directory: Path) -> list[Path]:
    """What is there of a recording, in order."""
    found = {}
    for path in directory.iterdir():
        matched = PART.fullmatch(path.name)
        if matched is not None or path.name == RECORDING:
            found[int(matched[1]) if matched is not None else 1] = path
    return [found[number] for number in sorted(found)]


class PartedRecording:
    """Rows go in, whole parts come out. Whatever the disk raises goes through."""

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
        while len(rows):
            if not self._left:
                self._change()
            now, rows = rows.split(self._left)
            self._file.add(now)
            self._left -= len(now)

    def _change(self) -> None:
        """The next part is there before the one before is whole, so that a run that is killed in between is seen to be unfinished."""
        with self._stream:
            before, self._file = self._file, self._next()
            before.end({"file": self.paths[-1].name}, NEXT)

    def flush(self) -> None:
        """Whole chunks to the system. OSError too if the file's name has gone: such a file takes everything and keeps nothing."""
        self._file.flush()
        found = os.stat(self.paths[-1])
        if (found.st_dev, found.st_ino) != (self._identity.st_dev, self._identity.st_ino):
            raise OSError(0, f"{self.paths[-1]} has been replaced by somebody")

    def finish(self, stop: Mapping[str, str]) -> None:
        with self._stream:
            self._file.finish(stop)


def started(path: Path) -> str | None:
    """When the run of a part began, as it says itself; None if it does not."""
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
    """What a ring has and the recording has not, as a further part; None if nothing is missing, or nothing was to be recorded.

    OutputError if it cannot be written.
    """
    head = ring.head
    rows = ring.everything()
    if not head.records or not len(rows):
        return None
    directory = Path(head.directory)
    there = parts(directory) if directory.is_dir() else []
    ours = [path for path in there if started(path) == str(head.started)]
    made = topics(head, chosen(head))
    # Packed, so many rows are never more.
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
            file.add(
                rows.where(np.arange(len(rows)) == i), absent[i]
            )  # an instant in the middle of which a chunk ended
        file.add(rows.where(whole))
        file.finish(stop_of(ring, recorder, clock_steps))

    if len(ours) == len(there):
        return save(part(directory, number_of(there[-1]) + 1 if there else 1), write)
    return save(directory / f"{Path(RECORDING).stem}_of_{head.started}_rest.mcap", write)


def number_of(path: Path) -> int:
    matched = PART.fullmatch(path.name)
    return 1 if matched is None else int(matched[1])


def _recorded(paths: list[Path], times: set[int], tail: int) -> dict[int, set[str]]:
    """Which topics the ends of some parts have at these times [ns since the epoch]."""
    found: dict[int, set[str]] = defaultdict(set)
    for path in paths:
        with path.open("rb") as file:
            for record in DamagedMcap(file).records(tail):
                if isinstance(record, WholeMessage) and record.log_time in times:
                    found[record.log_time].add(record.channel.topic)
    return found
