"""Recovery of damaged or unfinished recordings, CAN logs and rings.

The result is a new file. A damaged recording or CAN log is not changed. A ring is removed after its
data has been written to files.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from mcap.records import Attachment, Metadata
from mcap.writer import CompressionType, Writer

from freeflyer.foundation.errors import CosimError, RecordError
from freeflyer.foundation.output_file import check_writable, write_whole
from freeflyer_adapters.recording.damaged_blf import copy_frames, unread
from freeflyer_adapters.recording.damaged_mcap import Damage, DamagedMcap, WholeMessage
from freeflyer_adapters.recording.mcap_file import library
from freeflyer_adapters.recording.ring import RingReader, folder, is_left_behind
from freeflyer_adapters.recording.ring_recovery import Saved, save_ring

RECOVERED = "freeflyer.recovered"
SUFFIXES = (".mcap", ".blf", ".ring")
CHUNK = 256 * 1024
EARLIEST, LATEST = 0, 2**63
Progress = Callable[[int, int], None]
"""Function that is called with the number of processed bytes and the size of the file."""


@dataclass(frozen=True, kw_only=True)
class Recovered:
    """The result of a recovery.

    `kept`: number of recovered messages or frames. `begin`, `end`: earliest and latest time of
    these messages or frames [ns since the epoch]. `path`: the new file. It is None if no new file
    was necessary.
    """

    source: Path
    path: Path | None
    kept: int
    begin: int | None
    end: int | None
    lost: str
    rest: Path | None = None
    """Further part of the recording, with rows that were only in the ring."""

    @property
    def sentence(self) -> str:
        """Message about the result in one line."""
        if self.rest is not None:
            return f"{self.path}: kept {self._kept}; the end of the recording was only in memory and is now in {self.rest}"
        if self.path is None:
            return f"{self.source} is complete: {self._kept}; nothing was written"
        return f"{self.path}: kept {self._kept}; {self.lost or 'nothing was lost'}"

    @property
    def _kept(self) -> str:
        if self.begin is None or self.end is None:
            return f"{self.kept} messages"
        first = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(self.begin // 1_000_000_000))
        rest = self.begin % 1_000_000_000 // 1_000_000
        return f"{self.kept} messages of {(self.end - self.begin) * 1e-9:.3f} s from {first}.{rest:03d} UTC"


def recover(path: Path, out: Path | None = None, progress: Progress | None = None) -> Recovered:
    """Recover a recording, a CAN log or a ring.

    `out`: path of the new file. By default, the name ends in `_recovered`, and no file is written
    if `path` is complete. Raises RecordError if the file is not a recording, a CAN log or a ring.
    Raises OutputError if the result cannot be written.
    """
    # The data of a ring is written to files in the directory of its run, so `out` is not possible.
    suffix = path.suffix.lower()
    if suffix == ".ring":
        if out is not None:
            raise RecordError(
                f"--out {out}: the data of a ring is always written to the directory of its run; omit --out"
            )
        _reject_foreign_ring(path)
        saved = save_ring(path)
        return _ring_result(path, saved)
    if suffix not in SUFFIXES:
        raise RecordError(
            f"{path}: the name of a recording (.mcap), a CAN log (.blf) or a ring (.ring) is expected"
        )
    # A file is copied if a first pass finds damage, or if `out` is given.
    target = out or path.with_name(f"{path.stem}_recovered{path.suffix}")
    with _opened(path) as file:
        if target.exists() and os.path.samefile(target, path):
            raise RecordError(
                f"--out {target} is the damaged file itself, but a recovery must write a new file; choose another name"
            )
        found: list[Recovered] = []
        if out is None:
            checked = copy_whole(path, file, None, progress)
            if checked.path is None:
                return checked

        def write(partial: Path) -> None:
            with partial.open("wb") as stream:
                found.append(copy_whole(path, file, stream, progress))
                if not stream.closed:  # python-can closes the stream
                    os.fsync(stream.fileno())

        check_writable(target.parent)
        write_whole(target, write)
    return replace(found[0], path=target)


def _reject_foreign_ring(path: Path) -> None:
    """Raise RecordError if a ring is not trusted.

    The header of a ring names the directory to which the files are written. A foreign ring could
    name any directory. Therefore a ring is trusted only if it is in the directory that it names, or
    in the user's directory of rings.
    """
    if path.absolute().parent not in (folder().absolute(), _directory_of(path)):
        raise RecordError(
            f"ring {path} would be saved in {_directory_of(path)}, but the ring is neither in this directory nor in {folder()}; "
            f"move the ring to {folder()} if you trust it"
        )


def copy_whole(
    path: Path, file: BinaryIO, output: BinaryIO | None, progress: Progress | None = None
) -> Recovered:
    """Copy the intact data of `file` to `output`. `file` is a CAN log (.blf) or a recording.

    If `output` is None, only check the file.
    """
    copy = _copy_frames if path.suffix.lower() == ".blf" else _copy_messages
    return copy(path, file, output, progress)


def unfinished(directory: Path) -> Iterator[Path]:
    """Yield the rings of ended runs, then the files in `directory` that `recover` accepts.

    The rings are those of runs whose results are in `directory`. Files that an earlier recovery
    wrote are left out.

    Raises RecordError if the directory cannot be read.
    """
    try:
        names = sorted(path for path in directory.iterdir() if path.suffix.lower() in SUFFIXES)
    except OSError as error:
        raise RecordError(f"{directory} cannot be read: {error.strerror}") from error
    yield from rings_of(directory)
    yield from (path for path in names if "_recovered" not in path.stem)


def rings_of(directory: Path) -> Iterator[Path]:
    """Yield the rings of ended runs whose results are in `directory`.

    A run has ended when its loop and its recorder have ended.
    """
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


def _ring_result(ring: Path, saved: Saved) -> Recovered:
    if saved.flight is None:
        return Recovered(source=ring, path=None, kept=0, begin=None, end=None, lost="")
    with _opened(saved.flight) as file:
        copied = _copy_messages(saved.flight, file, None, None)
    return replace(copied, source=ring, path=saved.flight, lost="", rest=saved.rest)


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        with path.open("rb") as file:
            if not path.is_file():
                raise RecordError(f"{path} is not a regular file")
            yield file
    except OSError as error:
        raise RecordError(f"{path} cannot be read: {error.strerror or error}") from error


def _copy_messages(
    path: Path, file: BinaryIO, stream: BinaryIO | None, progress: Progress | None
) -> Recovered:
    """Copy all intact messages to a new file. If `stream` is None, only check the file."""
    source = DamagedMcap(file)
    kept, others, times = 0, 0, (LATEST, EARLIEST)
    output = None if stream is None else _Output(stream)
    for record in source.records():
        if isinstance(record, WholeMessage):
            kept += 1
            times = min(times[0], record.log_time), max(times[1], record.log_time)
            if progress is not None and kept % 10_000 == 0:
                progress(file.tell(), source.size)
        else:
            others += 1
        if output is not None:
            output.add(record)
    damage = source.damage
    if not kept and not others and not source.has_magic:
        raise RecordError(
            f"{path} is not an MCAP recording: it has neither the magic bytes at its start nor an intact chunk"
        )
    lost = _lost(damage, kept)
    if output is not None:
        output.finish(path, kept, lost)
    begin, end = times if kept else (None, None)
    new = None if damage.is_whole and not lost and stream is None else path
    return Recovered(source=path, path=new, kept=kept, begin=begin, end=end, lost=lost)


def _lost(damage: Damage, kept: int) -> str:
    parts = []
    if damage.expected is not None and damage.expected > kept:
        parts.append(f"{damage.expected - kept} of {damage.expected} messages lost")
    if damage.skipped:
        parts.append(unread(damage.skipped, damage.places))
    if damage.undefined:
        parts.append(
            f"{damage.undefined} messages lost because their definition is missing in the file"
        )
    if damage.exhausted:
        parts.append(
            "reading was aborted: the file needs more memory or time than a file of this size may need"
        )
    if not parts and not damage.is_whole:
        parts.append(
            "the end of the file was missing; the index and the summary were written again"
        )
    return ", ".join(parts)


class _Output:
    """The new MCAP file. Its schemas and channels are copied from the damaged file."""

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
    kept, begin, end, lost = copy_frames(path, file, stream)
    new = path if lost or stream is not None else None
    return Recovered(source=path, path=new, kept=kept, begin=begin, end=end, lost=lost)
