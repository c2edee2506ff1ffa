"""Makes whole files of what a killed recorder, a full disk or a bad disk has left: beside the original, which is not touched."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.records import Attachment, Metadata
from mcap.writer import CompressionType, Writer

from freeflyer.foundation.errors import CosimError, RecordError
from freeflyer.foundation.output_file import write_whole
from freeflyer_adapters.recording.damaged_blf import copy_frames
from freeflyer_adapters.recording.damaged_mcap import Damage, DamagedMcap, WholeMessage
from freeflyer_adapters.recording.recording_file import library
from freeflyer_adapters.recording.rescue import Saved, save_ring
from freeflyer_adapters.recording.ring import RingReader, folder, is_left_behind

RECOVERED = "freeflyer.recovered"
SUFFIXES = (".mcap", ".blf", ".ring")
CHUNK = 256 * 1024
EARLIEST, LATEST = 0, 2**63
Progress = Callable[[int, int], None]
"""Called with the bytes done, and all of them."""


@dataclass(frozen=True, kw_only=True)
class Recovered:
    """`kept`: messages or frames from `begin` to `end` [ns since the epoch]; `path` is None where nothing had to be written."""

    source: Path
    path: Path | None
    kept: int
    begin: int | None
    end: int | None
    lost: str
    rest: Path | None = None
    """The further part of a recording that was made of a ring."""

    @property
    def sentence(self) -> str:
        if self.rest is not None:
            return f"{self.path}: kept {self._kept}; the end of the recording was in memory still, and is in {self.rest}"
        if self.path is None:
            return f"{self.source} is whole: {self._kept}; nothing was written"
        return f"{self.path}: kept {self._kept}; {self.lost or 'nothing was lost'}"

    @property
    def _kept(self) -> str:
        if self.begin is None or self.end is None:
            return f"{self.kept} messages"
        first = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(self.begin // 1_000_000_000))
        rest = self.begin % 1_000_000_000 // 1_000_000
        return f"{self.kept} messages of {(self.end - self.begin) * 1e-9:.3f} s from {first}.{rest:03d} UTC"


def recover(path: Path, out: Path | None = None, progress: Progress | None = None) -> Recovered:
    """A recording, a CAN log or a ring. RecordError for a file that is none, OutputError if the result cannot be written."""
    suffix = path.suffix.lower()
    if suffix == ".ring":
        if out is not None:
            raise RecordError(f"--out {out}: a ring goes into the directory of its run")
        _refuse_a_strangers(path)
        saved = save_ring(path)
        return _told(path, saved)
    if suffix not in SUFFIXES:
        raise RecordError(
            f"{path} is neither a recording (.mcap) nor a CAN log (.blf) nor a ring (.ring), by its name"
        )
    target = out or path.with_name(f"{path.stem}_recovered{path.suffix}")
    with _opened(path) as file:
        if target.exists() and os.path.samefile(target, path):
            raise RecordError(
                f"--out {target} is the damaged file itself, which is not touched; another name is expected"
            )
        found: list[Recovered] = []
        if out is None:
            checked = copy_whole(path, file, None, progress)
            if checked.path is None:
                return checked

        def write(partial: Path) -> None:
            with partial.open("wb") as stream:
                found.append(copy_whole(path, file, stream, progress))
                if not stream.closed:  # python-can closes what it has written
                    os.fsync(stream.fileno())

        write_whole(target, write)
    done = found[0]
    return Recovered(
        source=path, path=target, kept=done.kept, begin=done.begin, end=done.end, lost=done.lost
    )


def _refuse_a_strangers(path: Path) -> None:
    """A ring says itself where its files go: somebody else's would write where he likes."""
    if path.absolute().parent not in (folder().absolute(), _directory_of(path)):
        raise RecordError(
            f"ring {path} writes into {_directory_of(path)}, and lies neither there nor among your own rings; move it into {folder()} if you "
            f"trust it"
        )


def copy_whole(
    path: Path, file: BinaryIO, output: BinaryIO | None, progress: Progress | None = None
) -> Recovered:
    """What is whole in a recording or, by the name, a CAN log, into `output`; without it, only looked at."""
    copy = _copy_frames if path.suffix.lower() == ".blf" else _copy_messages
    return copy(path, file, output, progress)


def unfinished(directory: Path) -> Iterator[Path]:
    """What `recover` can do something for in a run's directory, and rings of that run that were left behind."""
    try:
        names = sorted(path for path in directory.iterdir() if path.suffix.lower() in SUFFIXES)
    except OSError as error:
        raise RecordError(f"{directory} cannot be read: {error.strerror}") from error
    yield from rings_of(directory)
    yield from (path for path in names if "_recovered" not in path.stem)


def rings_of(directory: Path) -> Iterator[Path]:
    """Of a run there whose loop and recorder have both died."""
    for path in sorted(folder().glob("*.ring")):
        try:
            if is_left_behind(path) and _directory_of(path) == directory.absolute():
                yield path
        except CosimError:
            continue


def _directory_of(path: Path) -> Path:
    ring = RingReader(path)
    ring.close()
    return Path(ring.head.directory)


def _told(ring: Path, saved: Saved) -> Recovered:
    if saved.flight is None:
        return Recovered(source=ring, path=None, kept=0, begin=None, end=None, lost="")
    with _opened(saved.flight) as file:
        copied = _copy_messages(saved.flight, file, None, None)
    return Recovered(
        source=ring,
        path=saved.flight,
        kept=copied.kept,
        begin=copied.begin,
        end=copied.end,
        lost="",
        rest=saved.rest,
    )


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        with path.open("rb") as file:
            if not path.is_file():
                raise RecordError(f"{path} is no ordinary file")
            yield file
    except OSError as error:
        raise RecordError(f"{path} cannot be read: {error.strerror or error}") from error


def _copy_messages(
    path: Path, file: BinaryIO, stream: BinaryIO | None, progress: Progress | None
) -> Recovered:
    """Every whole message, record by record, into a new file; without `stream`, only looked at."""
    source = DamagedMcap(file)
    kept, begin, end, others = 0, LATEST, EARLIEST, 0
    output = None if stream is None else _Output(stream)
    for record in source.records():
        if isinstance(record, WholeMessage):
            kept += 1
            begin, end = min(begin, record.log_time), max(end, record.log_time)
            if progress is not None and kept % 10_000 == 0:
                progress(file.tell(), source.size)
        else:
            others += 1
        if output is not None:
            output.add(record)
    damage = source.damage
    if not kept and not others and not source.begins_well:
        raise RecordError(
            f"{path} is no MCAP recording: it does not begin as one, and has no whole chunk"
        )
    lost = _lost(damage, kept)
    if output is not None:
        output.finish(path, kept, lost)
    span = (begin, end) if kept else (None, None)
    whole = damage.is_whole and not lost and stream is None
    return Recovered(
        source=path, path=None if whole else path, kept=kept, begin=span[0], end=span[1], lost=lost
    )


def _lost(damage: Damage, kept: int) -> str:
    parts = []
    if damage.expected is not None and damage.expected > kept:
        parts.append(f"{damage.expected - kept} of {damage.expected} messages lost")
    if damage.skipped:
        parts.append(
            f"{damage.skipped} bytes in {damage.places} place{'s' * (damage.places > 1)} could not be read"
        )
    if damage.undefined:
        parts.append(f"{damage.undefined} messages lost whose definition is nowhere in the file")
    if damage.exhausted:
        parts.append(
            "reading was given up: the file asks for more memory or time than one of its size may"
        )
    if not parts and not damage.is_whole:
        parts.append("the end was missing: index and summary are new")
    return ", ".join(parts)


class _Output:
    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._writer = Writer(self._stream, chunk_size=CHUNK, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=library())
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}

    def add(self, record: WholeMessage | Metadata | Attachment) -> None:
        if isinstance(record, Metadata):
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
        else:
            channel, schema = record.channel, record.schema
            if channel.id not in self._channels:
                if schema is not None and schema.id not in self._schemas:
                    number = self._writer.register_schema(schema.name, schema.encoding, schema.data)
                    self._schemas[schema.id] = number
                self._channels[channel.id] = self._writer.register_channel(
                    channel.topic,
                    channel.message_encoding,
                    self._schemas[channel.schema_id],
                    channel.metadata,
                )
            self._writer.add_message(
                self._channels[channel.id],
                record.log_time,
                record.data,
                record.publish_time,
                record.sequence,
            )

    def finish(self, source: Path, kept: int, lost: str) -> None:
        self._writer.add_metadata(
            RECOVERED, {"from": source.name, "kept": str(kept), "lost": lost or "nothing"}
        )
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()


def _copy_frames(
    path: Path, file: BinaryIO, stream: BinaryIO | None, progress: Progress | None
) -> Recovered:
    kept, begin, end, lost, whole = copy_frames(path, file, stream)
    is_there = whole and stream is None
    return Recovered(
        source=path, path=None if is_there else path, kept=kept, begin=begin, end=end, lost=lost
    )
