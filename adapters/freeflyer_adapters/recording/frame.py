"""A recording as a pandas table in one line, with the columns of a run's record.parquet."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas
from mcap.records import Metadata

from freeflyer.fmi.component import Array
from freeflyer.foundation.errors import RecordError
from freeflyer.master.record import Signal
from freeflyer_adapters.recording.damaged_mcap import DamagedMcap, WholeMessage
from freeflyer_adapters.recording.header import WIDEST
from freeflyer_adapters.recording.parts import parts
from freeflyer_adapters.recording.recording_file import RUN, STARTED, STOP
from freeflyer_adapters.recording.topics import COLUMNS, LOOP

FIRST = 20
"""Where the numbers of a message begin whose header has an empty frame: encapsulation, stamp, text, alignment."""
LOOP_NUMBERS = ("monotonic_ns", "instant", "time")
"""What the loop's message has before its states and counters: two integers and the time of the scenario."""

Found = dict[tuple[str, str], tuple[str, str, list[int], list[bytes]]]
"""By topic and columns: both, times and messages."""


def read_recording(path: str | Path) -> pandas.DataFrame:
    """A file, or all parts of the recording in a run's directory.

    One row for each instant, one column for each element: `time` [s], the signals, the loop's states and counters, and the
    clocks. `.attrs` has `units`, `run` and `stop` (empty where the file does not tell).

    Files that were not finished, or are damaged, are read as far as they are whole. RecordError for a file that is no recording
    of a loop.
    """
    path = Path(path)
    found: Found = {}
    told: dict[str, dict[str, str]] = {RUN: {}, STOP: {}}
    try:
        files = parts(path) if path.is_dir() else [path]
        if not files:
            raise RecordError(f"{path} has no recording.mcap")
        for file in files:
            _take(file, found, told)
    except OSError as error:
        raise RecordError(f"{path} cannot be read: {error.strerror}") from error
    try:
        return _joined(found, told)
    except (ValueError, TypeError, KeyError, RecursionError, OverflowError, MemoryError) as error:
        text = " ".join(str(error).split())[:200]
        raise RecordError(
            f"{path}: its messages are not what a recording of a loop has: {text}"
        ) from error


def _take(path: Path, found: Found, told: dict[str, dict[str, str]]) -> None:
    """A file's messages; none of one that is another run's."""
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
            elif isinstance(record, Metadata) and record.name in told:
                metadata = dict(record.metadata)
                if record.name == RUN and told[RUN].get(
                    STARTED, metadata.get(STARTED)
                ) != metadata.get(STARTED):
                    return
                told[record.name] = metadata


def _joined(found: Found, told: dict[str, dict[str, str]]) -> pandas.DataFrame:
    tables, units = [], {"time": "s"}
    for topic, columns, times, data in sorted(found.values(), key=lambda part: part[0] == LOOP):
        table, its_units = _table(topic, columns, times, data)
        tables.append(table)
        units.update(its_units)
    if not tables:
        raise ValueError(
            "there is no whole one; a recording.mcap or flight_recording.mcap is expected"
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
        "run": told[RUN],
        "stop": told[STOP],
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
        raise ValueError("its columns do not fit")
    names = [column for signal in signals for column in signal.columns]
    units = dict(
        zip(names, (unit or "" for signal in signals for unit in signal.units), strict=True)
    )
    before = LOOP_NUMBERS if topic == LOOP else ()
    width = len(before) + len(names)
    if any(len(message) != FIRST + 8 * width for message in data):
        raise ValueError("a message has another length than its columns")
    words = np.frombuffer(b"".join(message[FIRST:] for message in data), dtype="<i8").reshape(
        len(data), width
    )
    numbers: Array = words.view("<f8")
    found: dict[str, Any] = {}
    for i, name in enumerate((*before, *names)):
        found[name] = words[:, i] if name in LOOP_NUMBERS[:2] and i < len(before) else numbers[:, i]
    if topic == LOOP:
        units.update(dict.fromkeys(LOOP_NUMBERS[:1], "ns") | {"instant": "", "time": "s"})
    table = pandas.DataFrame(found, index=pandas.Index(np.array(times, dtype=np.uint64)))
    return table[~table.index.duplicated()], units
