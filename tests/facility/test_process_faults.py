"""Faults of whole processes, and of links between them, over real sockets. Rules that are not under test are patient."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from flights import flight_of
from processes import PATIENT_LOOP, Rig, events, rig

from freeflyer_adapters.arm.frames import ArmFrames, FrameMapping
from freeflyer_adapters.arm.link import Receiver, open_bus

BASE_PATIENT, ARM_PATIENT = PATIENT_LOOP[2:], PATIENT_LOOP[:2]
WATCHDOG = "active -> safe_stop: no command for 4 cycles"


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Rig]:
    with rig(tmp_path) as made:
        yield made


def test_controllers_that_are_stopped_find_the_arm_safe_when_they_go_on(bench: Rig) -> None:
    facility = bench.facility("facility.forget_after_s=30.0")
    loop = bench.hil(*PATIENT_LOOP)
    facility.wait_for("inactive -> active: commanded")
    bench.wait_for_instants()
    loop.send(signal.SIGSTOP)
    facility.wait_for(WATCHDOG)
    facility.wait_for("no set point for 0.02 s; it holds its place")
    time.sleep(1.0)
    loop.send(signal.SIGCONT)
    assert loop.finish() == 3
    # Which of the two it notices first is a matter of whose frame it reads first.
    reason = "the arm went to safe_stop by itself|cycles in a row were lost|s old, its limit"
    assert re.search(reason, loop.text), loop.text
    assert "all devices were brought to rest" in " ".join(loop.said)
    flight_of(bench.folder / "hil", reason, gap=2.0)


@pytest.mark.slow
def test_an_overrun_of_the_controllers_is_stopped_by_the_arms_watchdog(bench: Rig) -> None:
    facility = bench.facility("facility.base_watchdog_s=1.0")
    loop = bench.hil(*PATIENT_LOOP)
    facility.wait_for("inactive -> active: commanded")
    bench.wait_for_instants()
    loop.send(signal.SIGSTOP)
    time.sleep(0.05)
    loop.send(signal.SIGCONT)
    facility.wait_for(WATCHDOG)
    assert loop.finish() == 3
    assert "the arm went to safe_stop by itself" in loop.text
    flight_of(bench.folder / "hil", "the arm went to safe_stop by itself; ")


@pytest.mark.slow
def test_a_facility_that_is_stopped_stops_the_controllers_and_brakes_when_it_goes_on(bench: Rig) -> None:
    facility = bench.facility("facility.base_watchdog_s=1.0")
    loop = bench.hil(*BASE_PATIENT)
    facility.wait_for("inactive -> active: commanded")
    bench.wait_for_instants()
    facility.send(signal.SIGSTOP)
    assert loop.finish() == 3
    reason = r"arm_drive: .*(20 cycles in a row were lost|state frame is 0.0\d+ s old)"
    assert re.search(reason, loop.text)
    flight_of(bench.folder / "hil", reason)
    assert "arm_drive had not confirmed to be at rest" in " ".join(loop.said)
    facility.send(signal.SIGCONT)
    facility.wait_for("arm_drive, cycle")
    time.sleep(1.0)
    report = bench.facility_report(facility)
    last = [event for event in events(report, "arm_drive") if "->" in event][-1]
    assert "active -> " in last


@pytest.mark.slow
def test_loss_and_corruption_over_real_sockets_are_never_used(tmp_path: Path) -> None:
    """What the loop has recorded is what the arm has sent: a listener beside both hears the frames, broken ones and all."""
    path = tmp_path / "faults.toml"
    path.write_text(
        'extends = "facility"\nstop_s = 20.0\n[facility]\nseed = 7\nbase_watchdog_s = 1.0\n'
        '[[facility.faults]]\ndevice = "arm_drive"\nkind = "loss"\nprobability = 0.2\nbegin_s = 0.2\n'
        '[[facility.faults]]\ndevice = "arm_drive"\nkind = "flipped_bits"\nprobability = 0.2\nbits = 2\nbegin_s = 0.2\n'
        '[[facility.faults]]\ndevice = "base_robot"\nkind = "flipped_bits"\nprobability = 0.2\nbits = 2\nbegin_s = 0.2\n'
    )
    with rig(tmp_path, str(path)) as bench:
        facility = bench.facility()
        frames = ArmFrames(FrameMapping(), 6)
        bus, whole = open_bus("local", bench.channel, True, [frames.state], {}), Receiver(frames.state)
        sent = set()
        try:
            loop = bench.hil(*PATIENT_LOOP)
            while loop.popen.poll() is None:
                message = bus.recv(0.2)
                numbers = whole.take(message) if message is not None else None
                if numbers is not None:
                    sent.add(tuple(numbers["joint_position"]))
        finally:
            bus.shutdown()
        assert loop.finish() == 3
        assert "the arm went to safe_stop by itself" in loop.text
        flight_of(bench.folder / "hil", "the arm went to safe_stop by itself")
        assert whole.rejected["wrong CRC"] > 0
        report = bench.facility_report(facility)
        assert any(WATCHDOG in event for event in events(report, "arm_drive"))
        assert len(report["faults"]) == 3
        record = bench.record()
        used = record[[f"arm_drive.joint_position[{j}]" for j in range(1, 7)]].to_numpy()
        assert {tuple(row) for row in used} <= sent
        pose = record[[f"base_robot.base_position[{j}]" for j in range(1, 4)]].to_numpy()
        assert np.abs(np.diff(pose, axis=0)).max() < 1e-3
        assert report["devices"]["base_robot"]["setpoints_refused"] > 0
