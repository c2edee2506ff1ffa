"""MCAP files of a run: the recording, and the flight recording (only the last seconds)."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from freeflyer.foundation.errors import OutputError
from freeflyer.foundation.output_file import write_whole
from freeflyer.master.record import Signal
from freeflyer_adapters.foundation import private_directory
from freeflyer_adapters.recording.ring import RingReader, Rows
from freeflyer_adapters.recording.ring_header import RecordingHeader
from freeflyer_adapters.recording.topics import topics

CHUNK_SECONDS = 0.05
"""Length of a chunk in real time [s]. If the process is killed, an incomplete chunk is lost."""
DEFINITIONS_EVERY = 5.0
"""Time after which the schemas and channels are written again [s].

A reader needs these definitions for the messages after a damaged place."""
FLIGHT_SECONDS = 2.0
RECORDING, FLIGHT = "recording.mcap", "flight_recording.mcap"
RUN, STOP = "freeflyer.run", "freeflyer.stop"
"""Names of metadata in a file.

`RUN` describes the run and is at the start of the file. `STOP` contains the reason of the stop and
is at the end of the file."""
STARTED = "started_ns"
CLOCK_STEPS = "clock steps"
"""Key in the metadata `STOP`. The value has one line for each step of the wall clock."""
ORIGIN = "origin.json"
MESSAGE_OVERHEAD = 31
"""Bytes of a message record in addition to its data."""
SILENT = "the controllers' process ended without a reported reason"


@cache
def library() -> str:
    """Return the names and versions of the software that writes the file."""
    return f"freeflyer-cosim {version('freeflyer-cosim')}; mcap {version('mcap')}"


class RecordingFile:
    """Writer of an MCAP file with the messages of `signals` and of the loop.

    `chunk_seconds`: length of a chunk in real time [s]. All methods raise the errors of the stream.
    """

    def __init__(
        self,
        stream: BinaryIO,
        head: RecordingHeader,
        signals: Sequence[Signal],
        chunk_seconds: float,
    ) -> None:
        self._topics = topics(head, signals)
        a_row = sum(topic.layout.size + MESSAGE_OVERHEAD for topic in self._topics)
        rows = max(1, round(chunk_seconds * 1e9 / head.tick))
        # The mcap writer ends a chunk at the size `chunk_size`. All rows have the same size. With
        # the size given here, each chunk contains `rows` rows.
        self._writer = Writer(stream, chunk_size=a_row * rows - 1, compression=CompressionType.ZSTD)
        self._stream, self._number, self._repeated = stream, 0, -1
        self._writer.start(profile="ros2", library=library())
        # Metadata and attachment at the start of the file.
        run = {
            "scenario": head.scenario,
            "title": head.title,
            "tick_ns": str(head.tick),
            STARTED: str(head.started),
        }
        self._writer.add_metadata(
            RUN, {**run, **{f"version of {name}": text for name, text in head.versions.items()}}
        )
        origin = json.dumps(head.origin).encode()
        self._writer.add_attachment(head.started, head.started, ORIGIN, "application/json", origin)
        # Register all topics, and keep their definitions for repetition.
        self._channels = []
        schemas: dict[str, int] = {}
        definitions = RecordBuilder()
        for topic in self._topics:
            name, text = topic.message, topic.definition.encode()
            if name not in schemas:
                schemas[name] = self._writer.register_schema(name, "ros2msg", text)
                Schema(id=schemas[name], name=name, encoding="ros2msg", data=text).write(
                    definitions
                )
            channel = self._writer.register_channel(
                topic.name, "cdr", schemas[name], dict(topic.metadata)
            )
            self._channels.append(channel)
            Channel(
                id=channel,
                topic=topic.name,
                message_encoding="cdr",
                metadata=dict(topic.metadata),
                schema_id=schemas[name],
            ).write(definitions)
        self._definitions = definitions.end()  # type: ignore[no-untyped-call]
        self._repeat_rows = max(1, round(DEFINITIONS_EVERY * 1e9 / head.tick))

    def add(self, rows: Rows, only: Collection[str] | None = None) -> None:
        """Add the messages of all rows. The time of a message is the wall time of its row.

        If `only` is given, add only the messages of these topics.
        """
        if not len(rows):
            return
        if self._number // self._repeat_rows > self._repeated:
            # Write directly to the stream. This is safe, because the mcap writer buffers no bytes
            # between calls and asks the stream for its position.
            self._repeated = self._number // self._repeat_rows
            self._stream.write(self._definitions)
        messages = [
            (channel, topic.layout.bytes_of(rows))
            for channel, topic in zip(self._channels, self._topics, strict=True)
            if only is None or topic.name in only
        ]
        for i, at in enumerate(rows.times[:, 0].tolist()):
            for channel, of_rows in messages:
                self._writer.add_message(channel, at, of_rows[i], at, self._number & 0xFFFFFFFF)
            self._number += 1

    def flush(self) -> None:
        """Flush complete chunks. A killed process loses no flushed chunk."""
        self._stream.flush()

    def finish(self, stop: Mapping[str, str]) -> None:
        """Write the reason of the stop, the index and the summary."""
        self.end(stop, STOP)

    def end(self, last: Mapping[str, str], name: str) -> None:
        """Write the metadata `last` with the name `name`, the index and the summary."""
        self._writer.add_metadata(name, dict(last))
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()


def chosen(head: RecordingHeader) -> list[Signal]:
    """Return the signals that the scenario table `[record]` selects."""
    return [signal for signal in head.signals if signal.name in head.chosen]


def stop_of(ring: RingReader, recorder: str, clock_steps: Sequence[str] = ()) -> dict[str, str]:
    """Return the metadata `STOP`.

    `recorder`: text that names the program that writes the file. `clock_steps`: messages about
    steps of the wall clock.
    """
    stop = {
        "reason": ring.reason or SILENT,
        "rows written by the loop": str(ring.written),
        "rows lost by the recorder": str(ring.lost),
        "written by": recorder,
    }
    return {**stop, CLOCK_STEPS: "\n".join(clock_steps)} if clock_steps else stop


def save_flight(
    ring: RingReader, recorder: str, name: str = FLIGHT, clock_steps: Sequence[str] = ()
) -> Path | None:
    """Write all signals of the last seconds before the stop. Return the path of the file.

    Return None if the ring has no row. `recorder`, `clock_steps`: see `stop_of`. `name`: name of
    the file in the directory of the run. See `save` for the errors, and for the case that this
    directory cannot be written.
    """
    rows = ring.last(FLIGHT_SECONDS)
    if not len(rows):
        return None
    return save(
        Path(ring.head.directory) / name,
        lambda stream: write_rows(stream, ring, rows, ring.head.signals, recorder, clock_steps),
    )


def write_rows(
    stream: BinaryIO,
    ring: RingReader,
    rows: Rows,
    signals: Sequence[Signal],
    recorder: str,
    clock_steps: Sequence[str] = (),
) -> None:
    """Write a complete MCAP file with the given rows. For the other arguments, see `stop_of`."""
    file = RecordingFile(stream, ring.head, signals, FLIGHT_SECONDS / 4)
    file.add(rows)
    file.finish(stop_of(ring, recorder, clock_steps))


def save(path: Path, write: Callable[[BinaryIO], object]) -> Path:
    """Write a file to `path`. If this fails, write it to a private temporary directory.

    Return the path of the written file. Raises OutputError if the file cannot be written to either
    place.
    """

    def write_partial(partial: Path) -> None:
        with partial.open("wb") as stream:
            write(stream)
            stream.flush()
            os.fsync(stream.fileno())

    try:
        write_whole(path, write_partial)
        return path
    except OutputError:
        second = fallback() / f"{time.strftime('%Y%m%dT%H%M%S')}_{path.name}"
        write_whole(second, write_partial)
        return second


def fallback() -> Path:
    """Return a private directory for files of runs whose directory cannot be written.

    Raises OutputError if this private directory cannot be created.
    """
    path = Path(tempfile.gettempdir()) / f"freeflyer-recordings-{os.getuid()}"
    if refused := private_directory.made(path):
        raise OutputError(refused)
    return path
