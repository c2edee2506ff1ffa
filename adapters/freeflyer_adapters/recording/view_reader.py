"""Reader of recordings for `freeflyer view` (entry-point group `freeflyer.view_readers`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from freeflyer.foundation.bounded_file import size
from freeflyer.foundation.errors import RecordError
from freeflyer.master.record import Record, Signal
from freeflyer.scenario.scenario import Scenario
from freeflyer_adapters.recording.data_frame import read_recording
from freeflyer_adapters.recording.parts import parts

LOSSES = ("lost", "late", "refused", "missed", "wrong", "dropped")
"""Parts of the names of the counters whose increments are faults."""
UNFINISHED = "the end of the recording is missing; its last rows may be lost"
LARGEST = 512 << 20
"""Largest size of a recording [bytes] that is read as a whole. Its data need several times more."""
MOST_FAULTS = 500
"""Largest number of faults that are returned for one counter."""


def read(path: Path, options: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the signals of a recording as a record, how its run ended, and its faults.

    `options` are not used. The keys are `record`, `title`, `end`, `cause`, `notes` and `marks`.
    Raises RecordError if the recording cannot be read, or if it has no times of the scenario.
    """
    frame = read_recording(path)
    if "time" not in frame:
        raise RecordError(f"{path} has no times of the scenario; recording.mcap or flight_recording.mcap is expected")  # fmt: skip
    frame = frame[np.isfinite(frame["time"])]
    run, stop = frame.attrs["run"], frame.attrs["stop"]
    reason = stop.get("reason")
    completed = reason is not None and reason.startswith("scenario finished")
    return {
        "record": _record(frame),
        "title": run.get("title", path.stem),
        "end": "completed" if completed else "interrupted",
        "cause": None if completed else reason or UNFINISHED,
        "notes": [] if reason else [f"{path}: {UNFINISHED}"],
        "marks": [
            mark for name in frame if ": " in str(name) for mark in _faults(frame, str(name))
        ],
    }


def record_of(directory: Path, scenario: Scenario) -> Record:
    """Return the record of a run with devices from its recording, with the interval of its rows.

    Raises RecordError if there is no recording, or if it cannot be read or is too large.
    """
    packed = sum(path.stat().st_size for path in parts(directory))
    if packed > LARGEST:
        raise RecordError(f"the recording in {directory} has {size(packed)}; at most {size(LARGEST)} are read at once. `read_recording` reads its parts")  # fmt: skip
    frame = read_recording(directory)
    frame = frame[np.isfinite(frame["time"])] if "time" in frame else frame[:0]
    instants = np.rint(frame["time"].to_numpy() * 1e9).astype(np.int64) if len(frame) else []
    kept = np.flatnonzero(np.asarray(instants) % scenario.record_every == 0)
    return _record(frame.iloc[kept])


def _record(frame: pandas.DataFrame) -> Record:
    elements: dict[str, list[str]] = {}
    for column in frame.columns:
        if "." in column and ": " not in column:
            elements.setdefault(column.partition("[")[0], []).append(column)
    signals, first = [], 0
    for name, columns in elements.items():
        units = tuple(frame.attrs["units"].get(column) or None for column in columns)
        signals.append(Signal(name=name, first=first, size=len(columns), units=units))
        first += len(columns)
    record = Record(signals, len(frame))
    times, values = record.storage
    times[:] = frame["time"]
    for place, column in enumerate(column for columns in elements.values() for column in columns):
        values[:, place] = frame[column]
    record.rows = len(frame)
    return record


def _faults(frame: pandas.DataFrame, name: str) -> Iterator[dict[str, Any]]:
    """Yield a mark for each increment of a counter of losses."""
    if not any(part in name for part in LOSSES):
        return
    increments = np.flatnonzero(np.diff(frame[name].to_numpy()) > 0.0) + 1
    for row in increments[:MOST_FAULTS]:
        yield {"kind": "fault", "time": float(frame["time"].iloc[row]), "until": None, "text": name}
