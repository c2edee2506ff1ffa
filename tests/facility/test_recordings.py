"""Recordings of a loop on the virtual facility: the recorded values match the CAN log."""

from __future__ import annotations

from pathlib import Path

import can
import cantools
import pytest
from processes import PATIENT_FACILITY, PATIENT_LOOP, rig

import freeflyer_adapters
from freeflyer_adapters import read_recording

STATE, COMMAND = 0x181, 0x101


@pytest.mark.slow
def test_the_can_log_contains_the_frames_of_the_recorded_values(tmp_path: Path) -> None:
    with rig(tmp_path) as bench:
        bench.facility(*PATIENT_FACILITY)
        loop = bench.hil(*PATIENT_LOOP, "stop_s=2.0")
        assert loop.finish() == 0, loop.text
        summary = bench.summary()["real_time"]
    assert summary["recording"]["missing"] == []
    assert summary["recording"]["rows_lost"] == 0
    out = tmp_path / "hil"
    frame = read_recording(out / "recording.mcap")
    assert frame["instant"].tolist() == list(range(2001))
    database = cantools.database.load_file(
        Path(freeflyer_adapters.__file__).parent / "arm" / "arm.dbc"
    )
    state = database.get_message_by_frame_id(STATE)
    frames = list(can.BLFReader(out / "can.blf"))
    logged = set()
    for message in frames:
        if message.arbitration_id == STATE:
            numbers = state.decode(bytes(message.data), decode_choices=False)
            logged.add(tuple(round(float(numbers[f"Position{i + 1}"]), 6) for i in range(6)))
    columns = [f"arm_drive.joint_position[{i + 1}]" for i in range(6)]
    measured = [tuple(round(float(value), 6) for value in row) for row in frame[columns].to_numpy()]
    # The log loses frames if the recorder is suspended and the buffer of its socket overflows.
    assert sum(row in logged for row in measured) > 0.8 * len(measured)
    commands = sum(message.arbitration_id == COMMAND for message in frames)
    assert 0.8 * 2000 < commands <= summary["devices"]["arm_drive"]["commands_sent"]
    counted = frame["arm_drive: commands sent"]
    assert (counted.diff().dropna() >= 0).all()
    assert counted.iloc[-1] > 2000
