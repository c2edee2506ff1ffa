"""Host side of the arm link against a scripted arm: losses, commands and stops, frame by frame."""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from freeflyer_adapters.arm.can_arm import CanArm
from freeflyer_adapters.arm.frames import LIMIT_ROLES, ArmFrames, FrameMapping, Mode
from freeflyer_adapters.arm.options import ArmOptions
from freeflyer_adapters.can.link import Receiver, Sender, open_bus
from freeflyer_adapters.device.device import LifeCycle, SafeStop
from freeflyer_adapters.device.quality import QualityMonitor
from freeflyer_adapters.foundation.errors import DeviceError

N = 6
UNWATCHED = 100_000.0
"""Watchdog of the arm [cycles], long enough for pauses between the calls of a test."""
numbers = itertools.count()


class ScriptedArm:
    """Test double of an arm.

    It sends a state frame per call of `send`. After `serve`, a thread responds to commands until
    the arm is active. `implicit`: the arm has no claims, and a torque frame activates it.
    """

    def __init__(self, channel: str, *, implicit: bool = False) -> None:
        self.implicit = implicit
        self.frames = ArmFrames(FrameMapping(), N)
        assert self.frames.description is not None
        self.bus = open_bus("local", channel, True, [self.frames.command], {})
        self.state = Sender(self.bus, self.frames.state)
        self.description = Sender(self.bus, self.frames.description)
        self.commands = Receiver(self.frames.command)
        self.cycle, self.accepted, self.life = 100, 0, LifeCycle.inactive
        self.position = np.zeros(N)
        self.echoed = 0
        """Echoed cycle of an implicit arm. An explicit arm echoes the previous cycle."""
        self.ignores_commands = self.ignores_activation = False
        self.received: list[dict[str, list[float]]] = []
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def send(self, cycle: int | None = None, **changed: Any) -> None:
        if cycle is not None:
            self.cycle = cycle
        values = {
            "cycle": (float(self.cycle),),
            "echoed_cycle": (float(self.echoed if self.implicit else (self.cycle - 1) % 2**24),),
            "obeyed_controller": (float(self.accepted),),
            "life_cycle": (float(self.life),),
            "brakes": (float(self.life is not LifeCycle.active),),
            "command_age": (0.0,),
            "joint_position": self.position.tolist(),
            "joint_velocity": [0.0] * N,
            "joint_torque": [0.0] * N,
        }
        self.state.send({**values, **changed})
        self.cycle = (self.cycle + 1) % 2**24

    def take(self) -> dict[str, list[float]] | None:
        """Read all pending commands, and return the newest one."""
        newest = None
        while (message := self.bus.recv(0.0)) is not None:
            found = self.commands.take(message)
            if found is not None:
                newest = found
                self.received.append(found)
                if found["mode"][0] == Mode.torque:
                    self.echoed = int(found["answered_cycle"][0])
        return newest

    def serve(self) -> None:
        self._stop.clear()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while not self._stop.wait(0.001):
            echoed = self.accepted
            command = self.take()
            if command is not None:
                self._execute(int(command["controller"][0]), command["mode"][0], echoed)
            limits = {role: [1.0 if "lower" not in role else -1.0] * N for role in LIMIT_ROLES}
            self.description.send({"joint_count": (float(N),), "cycle_time": (0.001,), **limits})
            self.send()

    def _execute(self, number: int, mode: float, echoed: int) -> None:
        """Execute a command of session `number`. `echoed`: number in the last state frame."""
        if self.ignores_commands:
            return
        if not self.accepted and (self.implicit or mode == Mode.reset):
            self.accepted = number
        if number != self.accepted:
            return
        if mode == Mode.reset:
            self.life = LifeCycle.inactive
        wanted = (
            mode == Mode.torque if self.implicit else mode == Mode.activate and number == echoed
        )
        if wanted and self.life is LifeCycle.inactive and not self.ignores_activation:
            self.life = LifeCycle.active

    def pause(self) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None


@pytest.fixture
def link() -> Iterator[tuple[CanArm, ScriptedArm]]:
    channel = f"test-arm-{os.getpid()}-{next(numbers)}"
    arm = CanArm("arm", ArmOptions(channel=channel))
    for name in ("joint_effort_limit", "joint_velocity_limit", "joint_upper_limit"):
        arm.values[name][:] = 1.0
    arm.values["joint_lower_limit"][:] = -1.0
    arm.values["watchdog_cycles"][:] = UNWATCHED
    there = ScriptedArm(channel)
    yield arm, there
    there.pause()
    arm.deactivate()
    there.bus.shutdown()


def begun(arm: CanArm) -> None:
    arm.configure()
    arm.check_start()
    arm.prepare()
    arm.activate(lambda: False)


@pytest.fixture
def active(link: tuple[CanArm, ScriptedArm]) -> tuple[CanArm, ScriptedArm]:
    arm, there = link
    there.serve()
    begun(arm)
    there.pause()
    arm._states.drain()
    there.take()
    there.received.clear()
    there.send()
    arm.read()
    arm.monitor = QualityMonitor("state frames of arm", consecutive=20, cycle=1e-3)
    arm.late_commands = 0
    return arm, there


def test_every_state_frame_is_answered_with_its_number(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    for _ in range(20):
        there.send()
        arm.read()
        arm.write()
        command = there.take()
        assert command is not None
        assert command["answered_cycle"][0] == there.cycle - 1
        assert command["mode"][0] == Mode.torque
    assert arm.monitor.lost == 0


def test_a_lost_frame_is_counted_once_and_the_last_received_number_is_answered(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = active
    last = there.cycle - 1
    there.cycle += 1  # one frame is lost
    arm.read()
    arm.write()
    command = there.take()
    assert command is not None
    assert command["answered_cycle"][0] == last
    there.send()
    arm.read()
    assert arm.monitor.lost == 1
    there.cycle += 3  # three frames are lost without a delay
    there.send()
    arm.read()
    assert arm.monitor.lost == 4


def test_the_freshest_of_several_frames_is_used_and_the_others_are_counted(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = active
    for k in range(3):
        there.send(joint_position=[0.1 * k] * N)
    arm.read()
    assert arm.values["joint_position"] == pytest.approx(np.full(N, 0.2))
    assert arm.monitor.lost == 2


def test_twenty_cycles_of_silence_stop(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, _ = active
    for _ in range(19):
        arm.read()
    with pytest.raises(SafeStop, match="20 cycles in a row were lost"):
        arm.read()
    assert arm.monitor.lost == 20


def test_frames_with_a_wrong_crc_count_as_lost(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = active
    assert there.state._protector is not None
    there.state._protector.data_id += 1
    there.send(joint_position=[0.5] * N)
    arm.read()
    assert arm.monitor.lost == 1
    assert not arm.values["joint_position"].any()
    assert arm.report()["state_frames_rejected"] == 1.0


def test_after_a_pause_of_the_arm_the_loop_continues(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    """No frame was lost: the arm continues with the next cycle number, and the loop has waited."""
    arm, there = active
    for _ in range(5):
        arm.read()
    assert arm.monitor.lost == 5
    there.send()
    arm.read()
    there.send()
    arm.read()
    assert arm.monitor.lost == 5


def test_a_restart_of_the_cycle_number_is_not_counted_as_loss(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = active
    there.send(cycle=5_000_000)
    with pytest.raises(SafeStop, match="in a row were lost"):
        arm.read()
    there.send(cycle=3)
    arm.read()


def test_the_cycle_number_wraps_around(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    arm._cycle_number = 2**24 - 2
    for cycle in (2**24 - 1, 0, 1):
        there.send(cycle=cycle)
        arm.read()
    assert arm.monitor.lost == 0
    assert arm.late_commands == 0


def test_a_safe_stop_of_the_arm_stops_the_loop_with_its_report(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = active
    there.life = LifeCycle.safe_stop
    there.send(command_age=(4.0,))
    with pytest.raises(
        SafeStop,
        match="went to safe_stop by itself; the last command that it accepted was 4 cycles old",
    ):
        arm.read()


def test_an_arm_that_accepts_another_controller_stops_the_loop_with_both_numbers(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = active
    there.accepted = arm.session.number % 0xFFFF + 1
    there.send()
    with pytest.raises(
        SafeStop,
        match=f"accepts commands from controller {there.accepted}; this run is controller {arm.session.number}",
    ):
        arm.read()


def test_a_nan_torque_is_not_sent(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    arm.values["joint_torque_command"][2] = np.nan
    with pytest.raises(SafeStop, match="finite numbers are expected"):
        arm.write()
    assert there.take() is None


def test_the_torque_starts_at_zero_and_its_rate_is_limited(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = active
    arm.values["torque_rate_limit"][:] = 100.0
    arm.limits.change[:] = 0.1
    arm.values["joint_torque_command"][:] = 1.0
    for k in range(1, 4):
        there.send()
        arm.read()
        arm.write()
        command = there.take()
        assert command is not None
        assert command["joint_torque_command"] == pytest.approx([0.1 * k] * N)


def test_an_arm_in_safe_stop_is_reset_before_it_is_activated(
    link: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = link
    there.life = LifeCycle.safe_stop
    there.serve()
    begun(arm)
    there.pause()
    there.take()
    modes = [command["mode"][0] for command in there.received]
    assert Mode.reset in modes
    assert modes.index(Mode.reset) < modes.index(Mode.activate) < modes.index(Mode.torque)


def test_an_incomplete_activation_ends_with_the_brakes(link: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = link
    arm.values["configure_timeout"][:] = 0.2
    there.serve()
    arm.configure()
    arm.prepare()
    there.pause()

    def stay_inactive() -> None:
        while not done.wait(0.001):
            there.take()
            there.life = LifeCycle.inactive
            there.send()

    done = threading.Event()
    thread = threading.Thread(target=stay_inactive)
    thread.start()
    try:
        with pytest.raises(DeviceError, match="does not become active; its state is inactive"):
            arm.activate(lambda: False)
        arm.deactivate()
    finally:
        done.set()
        thread.join()
    there.take()
    assert there.received[-1]["mode"][0] == Mode.brake


def test_an_arm_far_from_the_start_is_rejected_with_both_numbers(
    link: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = link
    there.position[3] = 0.3
    there.serve()
    arm.configure()
    with pytest.raises(
        DeviceError,
        match=r"joint 4 is at 0.3000 rad, the scenario starts at 0.0000 rad, and the largest allowed distance is 0.02 rad",
    ):
        arm.check_start()


def test_a_state_frame_too_old_stops_with_its_age_and_limit(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, _ = active
    arm.monitor = QualityMonitor("state frames of arm", consecutive=1000, cycle=1e-3)
    reason = r"the last state frame is 0\.021 s old, its limit is 0\.02 s"
    with pytest.raises(SafeStop, match=reason):  # noqa: PT012
        for _ in range(30):
            arm.read()


def test_a_joint_too_fast_or_beyond_its_range_stops(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    there.send(joint_velocity=[0.0, 1.2, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(SafeStop, match=r"joint 2 moves at 1\.2 rad/s, its limit is 1 rad/s"):
        arm.read()
    there.send(joint_position=[0.0, 0.0, 0.0, 0.0, 0.99, 0.0])
    with pytest.raises(
        SafeStop, match=r"joint 5 is at 0\.99 rad, its range is -0\.98 to 0\.98 rad"
    ):
        arm.read()


def brought_to_rest(
    arm: CanArm, there: ScriptedArm, seconds: float = 2.0
) -> list[dict[str, list[float]]]:
    """Ramp the arm down with one state frame per cycle, and return the commands."""
    arm.revoke("a test")
    there.take()
    there.received.clear()
    for k in range(round(seconds * 1000)):
        there.send()
        if arm.ramp_down(k * 1e-3):
            break
        there.take()
    there.take()
    return list(there.received)


def test_an_arm_that_reports_no_state_is_ramped_down(
    link: tuple[CanArm, ScriptedArm],
) -> None:
    """If the DBC has no life cycle and no brakes, the arm counts as moving until the ramp ends."""
    _, there = link
    channel = link[0].options.channel
    there.implicit = True
    arm = CanArm("arm", ArmOptions(channel=channel, implicit=True))
    for role in ("life_cycle", "brakes"):
        arm.frames.state.fields.pop(role)
    arm.values["watchdog_cycles"][:] = UNWATCHED
    for name in ("joint_velocity_limit", "joint_upper_limit"):
        arm.values[name][:] = 1.0
    arm.values["joint_lower_limit"][:] = -1.0
    arm.values["joint_effort_limit"][:] = 1.0
    there.serve()
    try:
        begun(arm)
        there.pause()
        arm._states.drain()
        arm._last_torque = np.full(N, 0.5)
        commands = brought_to_rest(arm, there)
        torques = [c["joint_torque_command"][0] for c in commands if c["mode"][0] == Mode.torque]
        assert len(torques) > 200
        assert torques[0] == pytest.approx(0.5, abs=0.01)
        assert torques[-1] == pytest.approx(0.0, abs=0.02)
        assert commands[-1]["mode"][0] == Mode.brake
        assert arm.at_rest
    finally:
        arm.deactivate()


def test_an_arm_that_reports_no_state_is_activated_after_a_pause(
    link: tuple[CanArm, ScriptedArm],
) -> None:
    """State frames that arrive between `prepare` and `activate` are discarded unread."""
    _, there = link
    there.implicit = True
    arm = CanArm("arm", ArmOptions(channel=link[0].options.channel, implicit=True))
    for role in ("life_cycle", "brakes", "echoed_cycle"):
        arm.frames.state.fields.pop(role)
    for name in ("joint_effort_limit", "joint_velocity_limit", "joint_upper_limit"):
        arm.values[name][:] = 1.0
    arm.values["joint_lower_limit"][:] = -1.0
    arm.values["watchdog_cycles"][:] = 100.0
    there.serve()
    try:
        arm.configure()
        arm.check_start()
        arm.prepare()
        time.sleep(0.3)
        arm.activate(lambda: False)
        assert arm.session.permit.lost is None
    finally:
        arm.deactivate()


def test_an_arm_is_at_rest_only_after_it_reports_its_brakes(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = active
    arm._last_torque = np.full(N, 0.5)
    arm.revoke("a test")
    there.received.clear()
    for k in range(400):
        there.send()
        arm.ramp_down(k * 1e-3)
    assert not arm.at_rest  # the arm has not reported engaged brakes
    there.life = LifeCycle.inactive
    there.send()
    assert arm.ramp_down(0.4)
    assert arm.at_rest


def test_an_arm_that_stops_by_itself_gets_no_command(active: tuple[CanArm, ScriptedArm]) -> None:
    """A brake command of the host would end the arm's own damped ramp early."""
    arm, there = active
    arm.revoke("a test")
    there.life = LifeCycle.safe_stop
    there.received.clear()
    for k in range(100):
        there.send(brakes=(0.0,))
        assert not arm.ramp_down(k * 1e-3)
    there.send(brakes=(1.0,))
    assert arm.ramp_down(0.1)
    assert arm.at_rest
    arm.on_error("the arm has stopped")
    arm.deactivate()
    there.take()
    assert [c for c in there.received if c["mode"][0] != Mode.torque] == []
    assert len(there.received) <= 1  # the answer to the frame that reported the stop


def test_an_unknown_state_number_is_a_fault(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    there.send(life_cycle=(7.0,))
    with pytest.raises(SafeStop, match="went to a state with the unknown number 7 by itself"):
        arm.read()


def test_the_narrower_cycle_number_of_both_frames_is_used(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = active
    arm.frames.cycles = 256
    arm._cycle_number = 1617 % 256
    there.send(cycle=1618, echoed_cycle=(float(1617 % 256),))
    arm.read()
    arm.write()
    command = there.take()
    assert command is not None
    assert command["answered_cycle"][0] == 1618 % 256


def test_a_claim_is_kept_while_other_devices_are_activated(
    link: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = link
    there.serve()
    arm.configure()
    arm.prepare()
    there.pause()
    there.take()
    there.received.clear()
    there.send()
    arm.stay()
    command = there.take()
    assert command is not None
    assert (command["mode"][0], command["controller"][0]) == (Mode.idle, arm.session.number)


@pytest.mark.parametrize(("limit", "rejected"), [(1.0, False), (0.5, False), (1.1, True)])
def test_speeds_and_torques_may_be_narrower_than_the_arms_own_but_not_wider(
    link: tuple[CanArm, ScriptedArm], limit: float, rejected: bool
) -> None:
    arm, there = link
    there.serve()
    for name in ("joint_effort_limit", "joint_velocity_limit"):
        arm.values[name][:] = limit
    if rejected:
        with pytest.raises(
            DeviceError,
            match=r"the joint velocity limit of joint 1 is 1 rad/s, .* robot has 1\.1 rad/s",
        ):
            arm.configure()
    else:
        arm.configure()


# Before the activation


def test_configuration_and_start_check_send_nothing(
    link: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = link
    there.serve()
    arm.configure()
    arm.check_start()
    there.pause()
    assert there.take() is None
    assert there.received == []
    assert there.accepted == 0
    assert arm.state.now is LifeCycle.inactive


def test_prepare_claims_a_number_and_keeps_the_brakes_engaged(
    link: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = link
    there.life = LifeCycle.fault
    there.serve()
    arm.configure()
    arm.prepare()
    there.pause()
    there.take()
    assert {c["mode"][0] for c in there.received} == {Mode.reset}
    assert {c["controller"][0] for c in there.received} == {there.accepted} == {arm.session.number}
    assert there.life is LifeCycle.inactive
    assert not arm.session.permit.is_held


def test_every_activation_has_a_new_session(link: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = link
    there.serve()
    arm.configure()
    arm.prepare()
    first = arm.session
    arm.activate(lambda: False)
    with pytest.raises(RuntimeError, match="this permit was taken or lost before"):
        arm.activate(lambda: False)
    there.accepted, there.life = 0, LifeCycle.inactive
    arm.prepare()
    assert arm.session is not first
    assert arm.session.permit is not first.permit


def test_an_arm_that_accepts_no_claim_is_rejected_with_the_echoed_number(
    link: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = link
    arm.values["configure_timeout"][:] = 0.3
    there.ignores_commands = True
    there.serve()
    arm.configure()
    with pytest.raises(
        DeviceError,
        match=r"sends its state \(inactive\), but does not accept .* commands; the echoed session number is none",
    ):
        arm.prepare()


@pytest.mark.parametrize("life", [LifeCycle.inactive, LifeCycle.active])
def test_an_arm_that_accepts_another_controller_is_rejected_with_both_numbers(
    link: tuple[CanArm, ScriptedArm], life: LifeCycle
) -> None:
    arm, there = link
    there.accepted, there.life = 4711, life
    there.serve()
    with pytest.raises(
        DeviceError,
        match=r"accepts commands from controller 4711 already; this run is controller \d+: stop the other controller first",
    ):
        arm.configure()
    there.pause()
    assert there.take() is None


def test_an_arm_that_another_controller_claims_before_prepare_is_rejected(
    link: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = link
    there.serve()
    arm.configure()
    there.accepted = 4711
    with pytest.raises(DeviceError, match="accepts commands from controller 4711 already"):
        arm.prepare()


def test_an_arm_that_is_active_without_a_session_is_rejected(
    link: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = link
    there.life = LifeCycle.active
    there.serve()
    with pytest.raises(DeviceError, match="is active already, and this run has not activated it"):
        arm.configure()


def test_nothing_is_commanded_before_the_activation(link: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = link
    there.serve()
    arm.configure()
    arm.prepare()
    there.pause()
    there.take()
    there.received.clear()
    with pytest.raises(SafeStop, match="it has not been activated"):
        arm.write()
    assert there.take() is None


class Foreign:
    """Sender of another controller's command frames, or of another arm's state frames, at 1 kHz."""

    def __init__(self, channel: str, frame: str) -> None:
        frames = ArmFrames(FrameMapping(), N)
        self.bus = open_bus("local", channel, True, [frames.description], {})  # type: ignore[list-item]
        self.sender = Sender(self.bus, getattr(frames, frame))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        cycle = 1000
        while not self._stop.wait(0.001):
            cycle += 1
            self.sender.send({"controller": (4711.0,), "cycle": (float(cycle),)})

    def __enter__(self) -> Foreign:
        for _ in range(128):  # make the counter differ much from the other arm's counter
            self.sender._protector.protect(bytearray(64))  # type: ignore[union-attr]
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self.bus.shutdown()


@pytest.mark.parametrize(
    ("frame", "sentence"),
    [
        (
            "command",
            "another controller sends the command frame ArmCommand .*, of session 4711; stop the other controller first",
        ),
        ("state", "two senders send the state frame ArmState"),
    ],
)
def test_a_second_controller_or_a_second_arm_is_rejected_before_anything_is_sent(
    link: tuple[CanArm, ScriptedArm], frame: str, sentence: str
) -> None:
    arm, there = link
    there.serve()
    with Foreign(arm.options.channel, frame), pytest.raises(DeviceError, match=sentence):
        arm.configure()
    there.pause()
    there.take()
    assert [c for c in there.received if c["controller"][0] != 4711.0] == []


def test_a_second_controller_stops_a_loop(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    frames = ArmFrames(FrameMapping(), N)
    bus = open_bus("local", arm.options.channel, True, [frames.state], {})
    try:
        foreign = Sender(bus, frames.command)
        for _ in range(3):
            foreign.send({"controller": (4711.0,), "mode": (float(Mode.torque),)})
        there.send()
        with pytest.raises(
            SafeStop, match=r"another controller sends the command frame .* of session 4711"
        ):
            arm.read()
    finally:
        bus.shutdown()


# Delays of the loop


def held_up(arm: CanArm) -> None:
    """Delay the loop for longer than the arm's watchdog."""
    arm.session.permit.watchdog = 10_000_000
    time.sleep(0.05)


def test_after_a_delay_of_the_loop_no_torque_is_sent(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    arm.values["joint_torque_command"][:] = 0.5
    held_up(arm)
    with pytest.raises(
        SafeStop,
        match=r"the loop was held up for 0\.\d+ s, longer than the watchdog of the arm \(0\.01 s\)",
    ):
        arm.write()
    assert there.take() is None


def test_a_delay_of_the_loop_is_detected_at_the_next_state_frame(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = active
    held_up(arm)
    there.send()
    with pytest.raises(SafeStop, match="the loop was held up for"):
        arm.read()


def test_the_ramp_down_after_a_delay_of_the_loop_has_no_torque_and_ends_with_the_brakes(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    """No recent state frame shows that the arm is still active."""
    arm, there = active
    arm._last_torque = np.full(N, 0.5)
    arm._stopping_torque = np.full(N, 0.5)
    held_up(arm)
    arm.revoke("the loop was held up")
    there.received.clear()
    for k in range(10):
        arm.ramp_down(k * 1e-3)
    arm.ramp_down(arm.ramp.time)
    there.take()
    assert [c["mode"][0] for c in there.received] == [Mode.idle] * 10 + [Mode.brake]
    assert all(not any(c["joint_torque_command"]) for c in there.received)


def test_a_delay_of_the_loop_during_the_activation_ends_it_with_the_brakes(
    link: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = link
    there.ignores_activation = True
    there.serve()
    arm.configure()
    arm.prepare()

    def meanwhile() -> bool:
        held_up(arm)
        return False

    with pytest.raises(DeviceError, match="was not activated: the loop was held up for"):
        arm.activate(meanwhile)
    there.pause()
    there.take()
    assert there.received[-1]["mode"][0] == Mode.brake
    assert arm.state.now is LifeCycle.inactive


def test_a_frame_whose_permission_ended_is_not_sent(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = active
    sent = arm._sender.sent
    assert not arm._sender.send({"mode": (float(Mode.torque),)}, lambda: False)
    assert arm._sender.sent == sent
    assert there.take() is None


# During and after a stop


def test_after_a_reason_to_stop_only_the_ramp_down_sends(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    arm, there = active
    arm.values["joint_torque_command"][:] = 0.5
    arm.revoke("the user stopped")
    with pytest.raises(SafeStop, match="the user stopped"):
        arm.write()
    assert there.take() is None
    assert {c["mode"][0] for c in brought_to_rest(arm, there)} == {Mode.torque, Mode.brake}


def test_an_arm_that_stops_during_the_ramp_down_gets_no_more_torque(
    active: tuple[CanArm, ScriptedArm],
) -> None:
    """Only an active arm gets torque."""
    arm, there = active
    arm._last_torque = np.full(N, 0.5)
    arm.revoke("the user stopped")
    for k in range(20):
        there.send()
        arm.ramp_down(k * 1e-3)
    there.life = LifeCycle.inactive
    there.send()
    arm.ramp_down(0.02)
    there.take()
    there.received.clear()
    for k in range(21, 40):
        there.send()
        arm.ramp_down(k * 1e-3)
    there.take()
    assert Mode.torque not in {c["mode"][0] for c in there.received}


def test_a_reason_to_stop_discards_the_frames_queued_in_the_interface(
    active: tuple[CanArm, ScriptedArm], monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, _ = active
    calls = []

    def flush() -> None:
        calls.append(True)
        raise NotImplementedError

    monkeypatch.setattr(arm._bus, "flush_tx_buffer", flush)
    arm.revoke("the user stopped")
    assert calls
    assert arm.session.permit.lost == "the user stopped"


def test_lost_cycles_during_a_flood_report_the_flood(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, _ = active
    arm._states.others = 10 * arm._states.receiver.accepted
    reason = r"cycles in a row were lost.*; a flood of frames: \d+ frames with other identifiers were received in addition to"
    with pytest.raises(SafeStop, match=reason):  # noqa: PT012
        for _ in range(20):
            arm.read()
