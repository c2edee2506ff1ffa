"""Faults of whole processes and of links over real sockets. Limits that are not tested are wide."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from flights import flight_of
from processes import (
    BASE_ALONE,
    PATIENT_ARM,
    PATIENT_BASE,
    PATIENT_LOOP,
    Rig,
    activations,
    events,
    rig,
)

from freeflyer_adapters.arm.frames import ArmFrames, FrameMapping
from freeflyer_adapters.can.link import Receiver, open_bus
from freeflyer_adapters.device.device import LifeCycle

WATCHDOG = "active -> safe_stop: no command for 4 cycles"


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Rig]:
    with rig(tmp_path) as made:
        yield made


def test_suspended_controllers_never_enable_the_power_of_a_braked_arm_again(
    tmp_path: Path,
) -> None:
    """All limits of both ends have their defaults."""
    # Several attempts: a shared machine may suspend the loop before the test does.
    for attempt in range(5):
        with rig(tmp_path / str(attempt)) as bench:
            facility, listener = bench.facility(), bench.listener()
            loop = bench.hil()
            facility.wait_for("inactive -> active: commanded")
            with suppress(AssertionError):
                bench.wait_for_instants(timeout=2.0)
            stopped = time.time()
            loop.send(signal.SIGSTOP)
            time.sleep(2.5)
            loop.send(signal.SIGCONT)
            assert loop.finish() == 3
            time.sleep(0.5)
            report = bench.facility_report(facility)
            if (
                next(state.at for state in listener.states if state.life is LifeCycle.safe_stop)
                < stopped
            ):
                continue
            assert not any(state.has_power for state in listener.after_the_first_brake())
            assert len(listener.after_the_first_brake()) > 2000
            for device in ("arm_drive", "base_robot"):
                assert activations(report, device) == 1, events(report, device)
            assert any(WATCHDOG in event for event in events(report, "arm_drive"))
            assert any(
                "no set point for 0.02 s; the robot holds its pose" in event
                for event in events(report, "base_robot")
            )
            assert loop.text.count("Stop:") == 1
            # The device that is written next after the suspension reports it.
            reason = r"the loop was held up for 2\.\d+ s, longer than the watchdog of the (arm \(0\.004 s\)|base robot \(0\.02 s\))"
            assert re.search(f"^Stop: (arm_drive|base_robot): {reason}", loop.text, re.MULTILINE), (
                loop.text
            )
            flight_of(bench.folder / "hil", reason, gap=3.0)
            return
    raise AssertionError("the machine suspended the loop in every attempt")


@pytest.mark.slow
def test_the_watchdog_of_the_arm_stops_it_after_an_overrun_of_the_controllers(bench: Rig) -> None:
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
def test_the_loop_reports_an_overrun_of_the_controllers_as_the_cause(bench: Rig) -> None:
    """With the default watchdog, the loop reports its suspension, not the reaction of the arm."""
    facility = bench.facility("facility.base_watchdog_s=1.0")
    loop = bench.hil(*PATIENT_BASE, *PATIENT_ARM[:2])
    facility.wait_for("inactive -> active: commanded")
    bench.wait_for_instants()
    loop.send(signal.SIGSTOP)
    time.sleep(0.05)
    loop.send(signal.SIGCONT)
    facility.wait_for("active -> safe_stop: no command for")
    assert loop.finish() == 3
    assert re.search(
        r"Stop: (arm_drive|base_robot): the loop was held up for 0\.\d+ s, longer than the watchdog",
        loop.text,
    ), loop.text
    assert activations(bench.facility_report(facility), "arm_drive") == 1


@pytest.mark.slow
def test_a_suspended_facility_stops_the_controllers_and_brakes_after_it_resumes(
    bench: Rig,
) -> None:
    facility = bench.facility("facility.base_watchdog_s=1.0")
    loop = bench.hil(*PATIENT_BASE)
    facility.wait_for("inactive -> active: commanded")
    bench.wait_for_instants()
    facility.send(signal.SIGSTOP)
    assert loop.finish() == 3
    reason = r"arm_drive: .*(20 cycles in a row were lost|state frame is 0.0\d+ s old)"
    assert re.search(reason, loop.text)
    flight_of(bench.folder / "hil", reason)
    assert "arm_drive had not confirmed to be at rest" in " ".join(loop.output)
    facility.send(signal.SIGCONT)
    facility.wait_for("arm_drive, cycle")
    time.sleep(1.0)
    report = bench.facility_report(facility)
    last = [event for event in events(report, "arm_drive") if "->" in event][-1]
    assert "active -> " in last


@pytest.mark.slow
def test_corrupted_frames_on_real_sockets_are_never_used(tmp_path: Path) -> None:
    """All recorded values were sent by the arm. A third node receives all frames for comparison."""
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
        bus, whole = (
            open_bus("local", bench.channel, True, [frames.state], {}),
            Receiver(frames.state),
        )
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


@pytest.mark.slow
def test_a_base_continues_after_its_clock_is_set_back_and_the_step_is_counted(
    tmp_path: Path,
) -> None:
    path = tmp_path / "set_back.toml"
    fault = '[[facility.faults]]\ndevice = "base_robot"\nkind = "clock_jump"\ndirection = "to_controller"\njump_s = -1.0\n'
    path.write_text(f"{BASE_ALONE}[facility]\nbase_watchdog_s = 1.0\n{fault}begin_s = 1.0\n")
    with rig(tmp_path, str(path)) as bench:
        base = f'devices.base_robot.connect=["{bench.endpoint}"]'
        facility = bench.start(
            "facility", str(path), "--set", base, "--out", str(tmp_path / "facility")
        )
        facility.wait_for("is there")
        loop = bench.start(
            "hil",
            str(path),
            "--set",
            base,
            "--set",
            "stop_s=3.0",
            "--no-view",
            "--out",
            str(tmp_path / "hil"),
        )
        assert loop.finish() == 0, loop.text
        report = bench.facility_report(facility)
    assert bench.summary()["real_time"]["devices"]["base_robot"]["clock_steps"] == 1
    assert activations(report, "base_robot") == 1
