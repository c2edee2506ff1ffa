"""Causes of a stop in `freeflyer hil` with simulated devices, at wall-clock rate."""

from __future__ import annotations

import json
import os
import signal
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run_command

from freeflyer.cli import main as command
from freeflyer.foundation.interrupts import interrupts, no_interrupts
from freeflyer.scenario import experiment, scenario
from freeflyer.scenario.experiment import Result
from freeflyer.scenario.scenario import Scenario
from freeflyer_adapters.device.device import LifeCycle, State
from freeflyer_adapters.device.simulated import SimulatedDevice
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.loop import graded_stop, hil
from freeflyer_adapters.loop.live_view import LiveValues
from freeflyer_adapters.loop.stop_notice import StopNotice
from freeflyer_adapters.recording.client import RecordingClient


def loaded(folder: Path, text: str = "", overrides: tuple[str, ...] = ("stop_s=0.5",)) -> Scenario:
    path = folder / "changed.toml"
    path.write_text(f'extends = "facility"\n{text}')
    return scenario.load(str(path), overrides)


def run(chosen: Scenario) -> tuple[Any, str]:
    result, report = hil.run(chosen, real_time=False, simulated=True, show=lambda text: None)
    return result, report.stop


def test_simulated_devices_match_the_simulation(tmp_path: Path) -> None:
    # The rate limit would change the first cycles.
    chosen = loaded(tmp_path, "[components.arm_drive.parameters]\ntorque_rate_limit = 1e6")
    there, stop = run(chosen)
    here = experiment.run(scenario.load("facility", ["stop_s=0.5"]))
    for name in (
        "hand_kinematics.end_effector_position",
        "base_robot.base_position",
        "satellite.base_position",
    ):
        # Not exactly equal: a device has no torque before its first command.
        assert np.abs(there.outcome.record[name] - here.outcome.record[name]).max() < 1e-5, name
    assert stop.startswith("scenario finished; all devices were brought to rest")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            '[[limits]]\nsignal = "base_controller.base_wrench"\nmaximum = 0.05\ncause = "the base\'s force is too large [N]"',
            "the base's force is too large [N]: base_controller.base_wrench is",
        ),
        (
            '[[limits]]\nsignal = "manipulator_controller.manipulator_observed_energy"\nminimum = 0.06\nfor_s = 0.05\n'
            'cause = "port M is active [J]"',
            "port M is active [J]: manipulator_controller.manipulator_observed_energy is",
        ),
        (
            "[devices.arm_drive.parameters]\njoint_velocity_limit = 0.001",
            "rad/s, its limit is 0.001 rad/s",
        ),
        (
            "[devices.arm_drive.parameters]\njoint_upper_limit = 0.0\njoint_limit_margin = 0.0",
            "its range is",
        ),
    ],
    ids=["base wrench", "observed energy", "joint velocity", "joint position"],
)
def test_a_limit_stops_the_loop_in_order_and_is_reported_with_value_and_unit(
    tmp_path: Path, text: str, sentence: str
) -> None:
    result, stop = run(loaded(tmp_path, text))
    assert sentence in stop
    assert "all devices were brought to rest" in stop
    assert result.outcome.simulated < 0.5
    assert not result.as_expected


def test_energy_below_its_bound_stops_the_loop_only_after_the_given_time(tmp_path: Path) -> None:
    text = '[[limits]]\nsignal = "manipulator_controller.manipulator_observed_energy"\nminimum = 1.0\nfor_s = {}\ncause = "active [J]"'
    result, stop = run(loaded(tmp_path, text.format(10.0)))
    assert result.as_expected
    result, stop = run(loaded(tmp_path, text.format(0.1)))
    assert result.outcome.simulated == pytest.approx(0.1, abs=0.0021)
    assert "for 0.1 s" in stop


def test_a_torque_beyond_the_limit_is_clipped_and_counted(tmp_path: Path) -> None:
    text = "[components.arm_drive.parameters]\ntorque_rate_limit = 0.5"
    result, report = hil.run(
        loaded(tmp_path, text), real_time=False, simulated=True, show=lambda text: None
    )
    assert result.as_expected
    assert report.devices["arm_drive"]["torque_rate_limit_acted"] > 0
    assert result.summary["real_time"]["devices"]["arm_drive"]["torque_rate_limit_acted"] > 0


def test_a_failed_controller_stops_the_arm_in_order(tmp_path: Path) -> None:
    """The reference leaves the workspace of the arm, so a check of the controllers ends the run."""
    text = "[components.reference_trajectory.parameters]\ndisplacement = [0.0, 0.0, -2.0]\nduration = 0.5"
    result, stop = run(loaded(tmp_path, text, ("stop_s=2.0",)))
    assert not result.as_expected
    assert "all devices were brought to rest" in stop


def test_the_live_view_continues_when_a_limit_starts_to_clip(tmp_path: Path) -> None:
    text = "[components.arm_drive.parameters]\ntorque_rate_limit = 0.5"
    result, report = hil.run(
        loaded(tmp_path, text), real_time=False, simulated=True, view=True, show=lambda text: None
    )
    assert result.as_expected
    assert report.devices["arm_drive"]["torque_rate_limit_acted"] > 0


@pytest.mark.slow
def test_the_viewer_of_a_real_time_loop_has_ordinary_priority(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    policies = []
    show = LiveValues.show

    def watched(self: LiveValues) -> None:
        show(self)
        assert self.viewer is not None
        policies.append(os.sched_getscheduler(self.viewer.pid))

    monkeypatch.setattr(LiveValues, "show", watched)
    result, _ = hil.run(
        loaded(tmp_path), real_time=True, simulated=True, view=True, show=lambda text: None
    )
    assert result.as_expected
    assert policies == [os.SCHED_OTHER]
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_settings_of_a_device_apply_to_its_simulation(tmp_path: Path) -> None:
    text = "[devices.base_robot.parameters]\nworkspace_upper = [0.001, 0.001, 0.001]"
    _, stop = run(loaded(tmp_path, text))
    assert "outside the workspace" in stop
    with pytest.raises(DeviceError, match="ramp_down_time is -1 s"):
        run(loaded(tmp_path, "[devices.arm_drive.parameters]\nramp_down_time = -1.0"))


@pytest.mark.parametrize("call", ["activate", "write", "ramp_down", "deactivate"])
def test_any_exception_of_a_driver_keeps_the_record_and_stops_the_other_devices(
    call: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: SimulatedDevice, *arguments: Any) -> bool:
        if self.name == "base_robot":
            raise OSError("the driver broke")
        return bool(original(self, *arguments))

    original = getattr(SimulatedDevice, call)
    monkeypatch.setattr(SimulatedDevice, call, broken)
    result, stop = run(loaded(tmp_path, "", ("stop_s=0.1",)))
    assert result.outcome.record.rows >= 1
    if call in ("activate", "write"):
        assert "the driver broke" in stop
    if call == "ramp_down":
        assert "base_robot had not confirmed to be at rest" in stop


def test_the_reason_precedes_all_files_and_is_sent_to_the_system_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    def noted(name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **keywords: Any) -> Any:
            done.append(name)
            return original(*arguments, **keywords)

        return call

    monkeypatch.setattr(hil, "stop", noted("devices stopped", hil.stop))
    monkeypatch.setattr(StopNotice, "give", noted("reason given", StopNotice.give))
    monkeypatch.setattr(RecordingClient, "close", noted("recording closed", RecordingClient.close))
    monkeypatch.setattr(Result, "finish", noted("results written", Result.finish))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as log:
        log.bind(str(tmp_path / "log"))
        out = tmp_path / "out"
        arguments = (
            "hil",
            "facility",
            "--simulated",
            "--no-real-time",
            "--no-view",
            "--set",
            "stop_s=0.1",
            "--out",
            str(out),
        )
        assert command.call((*arguments, "--log-to", f"syslog:{tmp_path / 'log'}")) == 0
        assert b"Stop: scenario finished; all devices were brought to rest" in log.recv(4096)
    assert done == ["devices stopped", "reason given", "recording closed", "results written"]
    written = json.loads((out / "stop.json").read_text())
    assert written["stopped"] is True
    assert written["reason"] == "scenario finished"


def test_an_invalid_log_is_rejected_before_a_device_is_opened(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, sentence = run_command(
        capsys, "hil", "facility", "--simulated", "--out", str(tmp_path), "--log-to", "sysloog"
    )
    assert code == 2
    assert "did you mean" in sentence
    assert not (tmp_path / "stop.json").exists()


def test_a_second_signal_does_not_interrupt_the_stop() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # after nohup, it is ignored
    try:
        _signals_during_the_stop()
    finally:
        signal.signal(signal.SIGHUP, before)


def _signals_during_the_stop() -> None:
    with interrupts() as asked:
        with no_interrupts():
            # A signal of `os.kill` can arrive later, if the kernel gives it to another thread.
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.raise_signal(number)
        assert not asked
        signal.raise_signal(signal.SIGHUP)  # the terminal was closed
        assert len(asked) == 1


class HalfActivated:
    """A device whose activation was given up after the first commands."""

    name, is_clock, may_have_power = "half", False, True

    def __init__(self, comes_to_rest: bool) -> None:
        self.state, self.calls, self._comes = State("half"), [], comes_to_rest
        self.state.to(LifeCycle.inactive)

    def revoke(self, reason: str) -> None:
        self.calls.append("revoke")

    def ramp_down(self, elapsed: float) -> bool:
        self.calls.append("ramp_down")
        return True

    @property
    def at_rest(self) -> bool:
        return self._comes and "ramp_down" in self.calls

    def on_error(self, reason: str) -> None: ...

    def deactivate(self) -> None:
        self.calls.append("deactivate")


@pytest.mark.parametrize("comes_to_rest", [True, False])
def test_a_device_with_an_incomplete_activation_is_brought_to_rest(
    comes_to_rest: bool,
) -> None:
    device: Any = HalfActivated(comes_to_rest)
    left = graded_stop.stop([device], 1_000_000, "a drive failed", orderly=False)
    assert device.calls == ["revoke", "ramp_down", "deactivate"]
    assert ("half had not confirmed to be at rest" in left) is not comes_to_rest
