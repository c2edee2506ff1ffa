"""Check of the flight recording that every stop must write: the last seconds and the reason."""

from __future__ import annotations

import re
from pathlib import Path

import pandas

from freeflyer_adapters import read_recording
from freeflyer_adapters.recording.mcap_file import FLIGHT_SECONDS

WITHIN = 5.0
"""Time limit for the flight recording after SIGKILL of the controllers, on a busy machine [s]."""


def flight_of(
    out: Path, reason: str, *, by: str = "the recorder", gap: float = 0.2
) -> pandas.DataFrame:
    """Check span, reason (a regular expression) and writer of the flight recording, and return it.

    `gap` [s]: a suspension of the loop that is allowed at the start of the recording.
    """
    frame = read_recording(out / "flight_recording.mcap")
    assert re.search(reason, frame.attrs["stop"]["reason"]), frame.attrs["stop"]
    assert frame.attrs["stop"]["written by"] == by
    span = (frame["monotonic_ns"].iloc[-1] - frame["monotonic_ns"].iloc[0]) * 1e-9
    assert span <= FLIGHT_SECONDS
    assert frame["instant"].iloc[0] == 0 or span >= FLIGHT_SECONDS - gap
    first = int(frame["instant"].iloc[0])
    assert frame["instant"].tolist() == list(range(first, first + len(frame)))
    assert {
        "arm_drive: state",
        "arm_drive.joint_position[1]",
        "base_robot.base_position[1]",
    } <= set(frame.columns)
    return frame
