"""Controllers and virtual CiA 402 drives as two processes on a classic CAN bus over sockets."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from processes import PATIENT_FACILITY, PATIENT_LOOP, Rig, events, rig

from freeflyer.scenario import experiment, scenario
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.loop import hil

SCENARIO = "facility_cia402"
PATIENT = (*PATIENT_LOOP, "devices.arm_drive.heartbeat_s=0.4")
SECONDS = 3.0


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Rig]:
    with rig(tmp_path, SCENARIO) as made:
        yield made


@pytest.mark.slow
def test_over_canopen_the_errors_match_the_simulation(bench: Rig) -> None:
    facility = bench.facility(*PATIENT_FACILITY, "devices.arm_drive.heartbeat_s=0.4")
    loop = bench.hil(*PATIENT, f"stop_s={SECONDS}")
    assert loop.finish() == 0, loop.text
    report = bench.facility_report(facility)
    summary = bench.summary()
    without_clock = experiment.run(scenario.load(SCENARIO, [f"stop_s={SECONDS}"])).summary
    for name in ("end_effector_position_error_m", "base_position_error_m"):
        assert summary[name]["max"] == pytest.approx(
            without_clock[name]["max"], rel=0.1, abs=1e-3
        ), name
    for name in ("end_effector_orientation_error_deg", "base_orientation_error_deg"):
        assert summary[name]["max"] == pytest.approx(
            without_clock[name]["max"], rel=0.1, abs=0.1
        ), name
    arm = summary["real_time"]["devices"]["arm_drive"]
    instants = summary["steps"]["arm_drive"]
    assert instants == round(SECONDS * 250)
    assert (
        summary["real_time"]["times"]["arm_drive: all drives' answers after SYNC"]["count"]
        >= instants - arm["cycles_lost"]
    )
    assert arm["bus_load_percent"] == 57.0
    assert report["devices"]["arm_drive"]["syncs"] >= instants
    found = events(report, "arm_drive")
    assert "all joints: Switched on -> Operation enabled" in found
    assert any(event.endswith("-> Switch on disabled") for event in found)
    assert not any("Fault" in event for event in found)


@pytest.mark.slow
def test_a_second_controller_is_rejected_and_the_first_one_continues(bench: Rig) -> None:
    facility = bench.facility(*PATIENT_FACILITY, "devices.arm_drive.heartbeat_s=0.4")
    first = bench.hil(*PATIENT, "stop_s=100.0", out="first")
    facility.wait_for("Operation enabled")
    second = bench.hil(*PATIENT, out="second")
    assert second.finish() == 2, second.text
    assert "another controller sends SYNC" in second.text, second.text
    first.send(signal.SIGINT)
    assert first.finish() == 3, first.text
    assert "interrupted by the user; all devices were brought to rest" in first.text


def test_drives_stop_and_brake_after_their_controller_was_killed(bench: Rig) -> None:
    facility = bench.facility("facility.arm_watchdog_cycles=50")
    loop = bench.hil(*PATIENT_LOOP)
    facility.wait_for("-> Operation enabled")
    time.sleep(0.3)
    loop.send(signal.SIGKILL)
    line = facility.wait_for("Operation enabled -> Fault reaction active")
    assert "0x8700 (no SYNC)" in line or "0x8130 (the host's heartbeat is missing)" in line
    facility.wait_for("Fault reaction active -> Fault")
    facility.wait_for("return to their start poses")


def run(
    channel: str, *settings: str, simulated: bool = False
) -> tuple[experiment.Result, hil.LoopReport]:
    chosen = scenario.load(SCENARIO, [f'devices.arm_drive.channel="{channel}"', *settings])
    return hil.run(chosen, real_time=False, simulated=simulated, show=lambda text: None)


def test_a_missing_drive_is_reported(bench: Rig) -> None:
    sentence = (
        "arm_drive: drive of joint 1 (node 1) does not return device type (1000h): no answer within 0.3 s; is the drive (or `freeflyer facility`) "
        f"running on CAN local:{bench.channel}"
    )
    with pytest.raises(DeviceError, match=re.escape(sentence)):
        run(bench.channel, "devices.arm_drive.parameters.configure_timeout=0.3")


def test_classic_can_at_1_ms_is_rejected_with_its_bus_load(bench: Rig) -> None:
    with pytest.raises(
        DeviceError, match=r"take up to 228 % of a CAN bus of 1000 kbit/s.*: a cycle of 3 ms fits"
    ):
        run(bench.channel, "devices.arm_drive.parameters.period=0.001")


def test_the_scenario_runs_with_simulated_devices_at_wall_clock_rate(bench: Rig) -> None:
    result, report = run(bench.channel, "stop_s=0.4", simulated=True)
    assert result.as_expected
    assert report.stop.startswith("scenario finished; all devices were brought to rest")
