"""Recordings as pandas tables, with the columns of record.parquet."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pandas
from mcap.records import Metadata

from freeflyer.fmi.component import Array
from freeflyer.foundation.errors import RecordError, one_line
from freeflyer.foundation.file_name import text_of
from freeflyer.master.record import Signal
from freeflyer_adapters.recording.damaged_mcap import DamagedMcap, WholeMessage
from freeflyer_adapters.recording.mcap_file import RUN, STARTED, STOP
from freeflyer_adapters.recording.parts import parts
from freeflyer_adapters.recording.ring_header import WIDEST
from freeflyer_adapters.recording.topics import COLUMNS, LOOP

FIRST = 20
"""Offset of the numbers in a message with an empty frame ID [bytes].

The encapsulation header, the stamp, the frame ID and padding are before the numbers."""
LOOP_NUMBERS = ("monotonic_ns", "instant", "time")
"""First numbers in a message of the topic /loop: two integers, then the scenario time [s]."""

Found = dict[tuple[str, str], tuple[str, str, list[int], list[bytes]]]
"""Maps (topic, columns) to (topic, columns, times, messages). `columns` is a text in JSON."""


def read_recording(path: str | os.PathLike[str]) -> pandas.DataFrame:
    """Read the recording at `path`: a file, or the directory of a run with all its parts.

    A recording consists of one or more files, its parts. The table has one row per instant. The
    columns are, in this order: `time` [s], the elements of the signals, the states and counters of
    the loop, `monotonic_ns`, `instant`, and the wall time `wall_ns`. The attribute `attrs` of the
    table contains `units`, and the metadata `run` and `stop` of the recording. If the recording
    does not contain the metadata, `run` and `stop` are empty. If a file is unfinished or damaged,
    its intact data is read. Raises RecordError if the file is not a recording of a loop.
    """
    path = Path(text_of(path, "the recording", RecordError))
    found: Found = {}
    metadata: dict[str, dict[str, str]] = {RUN: {}, STOP: {}}
    try:
        files = parts(path) if path.is_dir() else [path]
        if not files:
            raise RecordError(f"{path} has no recording.mcap")
        for file in files:
            _take(file, found, metadata)
    except OSError as error:
        raise RecordError(f"{path} cannot be read: {error.strerror}") from error
    try:
        return _joined(found, metadata)
    except (ValueError, TypeError, KeyError, RecursionError, OverflowError, MemoryError) as error:
        raise RecordError(
            f"{path} is not a valid recording of a loop: {one_line(error, 200)}"
        ) from error


def _take(path: Path, found: Found, metadata: dict[str, dict[str, str]]) -> None:
    """Add the messages and metadata of a file.

    Stop reading the file if its metadata are from another run than the files that were read before.
    """
    with path.open("rb") as file:
        for record in DamagedMcap(file).records():
            if isinstance(record, WholeMessage):
                channel = record.channel
                if COLUMNS in channel.metadata:
                    columns = channel.metadata[COLUMNS]
                    _, _, times, data = found.setdefault(
                        (channel.topic, columns), (channel.topic, columns, [], [])
                    )
                    times.append(record.log_time)
                    data.append(record.data)
            elif isinstance(record, Metadata) and record.name in metadata:
                entries = dict(record.metadata)
                if record.name == RUN and metadata[RUN].get(
                    STARTED, entries.get(STARTED)
                ) != entries.get(STARTED):
                    return
                metadata[record.name] = entries


def _joined(found: Found, metadata: dict[str, dict[str, str]]) -> pandas.DataFrame:
    tables, units = [], {"time": "s"}
    for topic, columns, times, data in sorted(found.values(), key=lambda part: part[0] == LOOP):
        table, its_units = _table(topic, columns, times, data)
        tables.append(table)
        units.update(its_units)
    if not tables:
        raise ValueError(
            "no intact message found; a recording.mcap or flight_recording.mcap is expected"
        )
    frame = pandas.concat(tables, axis=1).sort_index()
    frame = frame.loc[:, ~frame.columns.duplicated()]
    last = [name for name in frame.columns if name not in ("time", *LOOP_NUMBERS)]
    first = [name for name in ("time",) if name in frame]
    clocks = [name for name in LOOP_NUMBERS[:2] if name in frame]
    frame = frame[[*first, *last, *clocks]].rename_axis("wall_ns").reset_index()
    frame = frame[[*(name for name in frame.columns if name != "wall_ns"), "wall_ns"]]
    frame.attrs = {
        "units": {name: units.get(name, "ns") for name in frame.columns},
        "run": metadata[RUN],
        "stop": metadata[STOP],
    }
    return frame


def _table(
    topic: str, columns: str, times: list[int], data: list[bytes]
) -> tuple[pandas.DataFrame, dict[str, str]]:
    raw = json.loads(columns)
    signals = [
        Signal(name=str(c["name"]), first=0, size=int(c["size"]), units=tuple(map(str, c["units"])))
        for c in raw
    ]
    if (
        any(s.size < 1 or len(s.units) != s.size for s in signals)
        or sum(s.size for s in signals) > WIDEST
    ):
        raise ValueError(
            "the sizes and units of the columns do not match, or there are too many columns"
        )
    names = [column for signal in signals for column in signal.columns]
    units = dict(
        zip(names, (unit or "" for signal in signals for unit in signal.units), strict=True)
    )
    before = LOOP_NUMBERS if topic == LOOP else ()
    width = len(before) + len(names)
    if any(len(message) != FIRST + 8 * width for message in data):
        raise ValueError("the length of a message does not match the columns")
    integers = np.frombuffer(b"".join(message[FIRST:] for message in data), dtype="<i8").reshape(
        len(data), width
    )
    numbers: Array = integers.view("<f8")
    found: dict[str, Any] = {}
    for i, name in enumerate((*before, *names)):
        is_integer = name in LOOP_NUMBERS[:2] and i < len(before)
        found[name] = integers[:, i] if is_integer else numbers[:, i]
    if topic == LOOP:
        units.update(dict.fromkeys(LOOP_NUMBERS[:1], "ns") | {"instant": "", "time": "s"})
    table = pandas.DataFrame(found, index=pandas.Index(np.array(times, dtype=np.uint64)))
    return table[~table.index.duplicated()], units
