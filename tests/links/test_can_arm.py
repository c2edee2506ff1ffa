"""The host's side of the arm's link, frame by frame against a scripted arm: what is lost, what is answered, what stops."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from freeflyer_adapters.arm.can_arm import CanArm
from freeflyer_adapters.arm.frames import LIMIT_ROLES, ArmFrames, FrameMapping, Mode
from freeflyer_adapters.arm.link import Receiver, Sender, open_bus
from freeflyer_adapters.arm.options import ArmOptions
from freeflyer_adapters.device import DeviceError, LifeCycle, SafeStop
from freeflyer_adapters.quality import QualityMonitor

N = 6
numbers = itertools.count()


class ScriptedArm:
    """Sends what it is told to; while `serving`, answers as an arm does until it is active."""

    def __init__(self, channel: str) -> None:
        self.frames = ArmFrames(FrameMapping(), N)
        assert self.frames.description is not None
        self.bus = open_bus("local", channel, True, [self.frames.command], {})
        self.state = Sender(self.bus, self.frames.state)
        self.description = Sender(self.bus, self.frames.description)
        self.commands = Receiver(self.frames.command)
        self.cycle, self.obeyed, self.life = 100, 0, LifeCycle.inactive
        self.position = np.zeros(N)
        self.received: list[dict[str, list[float]]] = []
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def send(self, cycle: int | None = None, **changed: Any) -> None:
        if cycle is not None:
            self.cycle = cycle
        values = {
            "cycle": (float(self.cycle),),
            "echoed_cycle": (float((self.cycle - 1) % 2**24),),
            "obeyed_controller": (float(self.obeyed),),
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
        """The newest command."""
        newest = None
        while (message := self.bus.recv(0.0)) is not None:
            found = self.commands.take(message)
            if found is not None:
                newest = found
                self.received.append(found)
        return newest

    def serve(self) -> None:
        self._stop.clear()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while not self._stop.wait(0.001):
            command = self.take()
            if command is not None and not self.obeyed:
                self.obeyed = int(command["controller"][0])
            if command is not None and command["mode"][0] == Mode.torque and self.life is LifeCycle.inactive:
                self.life = LifeCycle.active
            if command is not None and command["mode"][0] == Mode.reset:
                self.life = LifeCycle.inactive
            limits = {role: [1.0 if "lower" not in role else -1.0] * N for role in LIMIT_ROLES}
            self.description.send({"joint_count": (float(N),), "cycle_time": (0.001,), **limits})
            self.send()

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
    there = ScriptedArm(channel)
    yield arm, there
    there.pause()
    arm.deactivate()
    there.bus.shutdown()


@pytest.fixture
def active(link: tuple[CanArm, ScriptedArm]) -> tuple[CanArm, ScriptedArm]:
    arm, there = link
    there.serve()
    arm.configure()
    arm.check_start()
    arm.activate(lambda: False)
    there.pause()
    arm._drain()
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


def test_a_lost_frame_is_counted_once_and_no_number_is_made_up(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    seen = there.cycle - 1
    there.cycle += 1  # one frame never comes
    arm.read()
    arm.write()
    command = there.take()
    assert command is not None
    assert command["answered_cycle"][0] == seen
    there.send()
    arm.read()
    assert arm.monitor.lost == 1
    there.cycle += 3  # three are skipped, without any time to wait for them
    there.send()
    arm.read()
    assert arm.monitor.lost == 4


def test_the_freshest_of_several_frames_is_used_and_the_others_are_counted(active: tuple[CanArm, ScriptedArm]) -> None:
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


def test_frames_that_fail_their_protection_are_lost_ones(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    assert there.state._protector is not None
    there.state._protector.data_id += 1
    there.send(joint_position=[0.5] * N)
    arm.read()
    assert arm.monitor.lost == 1
    assert not arm.values["joint_position"].any()
    assert arm.report()["state_frames_rejected"] == 1.0


def test_an_arm_whose_time_stood_still_is_followed_again(active: tuple[CanArm, ScriptedArm]) -> None:
    """It comes with the number that was due before the silence: nothing was lost on the way, but the loop has waited."""
    arm, there = active
    for _ in range(5):
        arm.read()
    assert arm.monitor.lost == 5
    there.send()
    arm.read()
    there.send()
    arm.read()
    assert arm.monitor.lost == 5


def test_an_arm_that_begins_anew_is_no_loss_of_millions(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    there.send(cycle=5_000_000)
    with pytest.raises(SafeStop, match="in a row were lost"):
        arm.read()
    there.send(cycle=3)
    arm.read()


def test_the_cycle_number_runs_over(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    arm._cycle_number = 2**24 - 2
    for cycle in (2**24 - 1, 0, 1):
        there.send(cycle=cycle)
        arm.read()
    assert arm.monitor.lost == 0
    assert arm.late_commands == 0


def test_the_arms_own_safe_stop_ends_the_loop_with_its_word(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    there.life = LifeCycle.safe_stop
    there.send(command_age=(4.0,))
    with pytest.raises(SafeStop, match="went to safe_stop by itself; the last command that it had was 4 cycles old"):
        arm.read()


def test_an_arm_that_obeys_somebody_else_ends_the_loop_with_both_numbers(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    there.obeyed = arm.controller % 0xFFFF + 1
    there.send()
    with pytest.raises(SafeStop, match=f"obeys controller {there.obeyed}; this is controller {arm.controller}"):
        arm.read()


def test_a_torque_that_is_no_number_is_not_sent(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    arm.values["joint_torque_command"][2] = np.nan
    with pytest.raises(SafeStop, match="finite numbers are expected"):
        arm.write()
    assert there.take() is None


def test_the_first_torque_is_none_and_grows_by_its_rate(active: tuple[CanArm, ScriptedArm]) -> None:
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


def test_an_arm_in_safe_stop_is_reset_before_it_is_activated(link: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = link
    there.life = LifeCycle.safe_stop
    there.serve()
    arm.configure()
    arm.check_start()
    arm.activate(lambda: False)
    there.pause()
    modes = [command["mode"][0] for command in there.received]
    assert Mode.reset in modes
    assert modes.index(Mode.reset) < modes.index(Mode.torque)


def test_giving_up_an_activation_brakes(link: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = link
    arm.values["configure_timeout"][:] = 0.2
    there.serve()
    arm.configure()
    there.pause()
    there.life = LifeCycle.inactive

    def stubborn() -> None:
        while not done.wait(0.001):
            there.take()
            there.life = LifeCycle.inactive
            there.send()

    done = threading.Event()
    thread = threading.Thread(target=stubborn)
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


def test_an_arm_far_from_the_start_is_refused_with_both_numbers(link: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = link
    there.position[3] = 0.3
    there.serve()
    arm.configure()
    with pytest.raises(DeviceError, match=r"joint 4 is at 0.3000 rad, the scenario starts at 0.0000 rad, and 0.02 rad"):
        arm.check_start()


def test_a_state_frame_too_old_stops_with_its_age_and_limit(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, _ = active
    arm.monitor = QualityMonitor("state frames of arm", consecutive=1000, cycle=1e-3)
    with pytest.raises(SafeStop, match=r"the last state frame is 0\.021 s old, its limit is 0\.02 s"):  # noqa: PT012
        for _ in range(30):
            arm.read()


def test_a_joint_too_fast_or_beyond_its_range_stops(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    there.send(joint_velocity=[0.0, 1.2, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(SafeStop, match=r"joint 2 moves at 1\.2 rad/s, its limit is 1 rad/s"):
        arm.read()
    there.send(joint_position=[0.0, 0.0, 0.0, 0.0, 0.99, 0.0])
    with pytest.raises(SafeStop, match=r"joint 5 is at 0\.99 rad, its range is -0\.98 to 0\.98 rad"):
        arm.read()


def brought_to_rest(arm: CanArm, there: ScriptedArm, seconds: float = 2.0) -> list[dict[str, list[float]]]:
    """The commands of a ramp-down, each answered by a state frame a cycle."""
    there.take()
    there.received.clear()
    for k in range(round(seconds * 1000)):
        there.send()
        if arm.ramp_down(k * 1e-3):
            break
        there.take()
    there.take()
    return list(there.received)


def test_an_arm_that_tells_nothing_is_ramped_down_all_the_same(link: tuple[CanArm, ScriptedArm]) -> None:
    """Without life cycle and brakes in its DBC, an arm is not taken to stand before the ramp is over."""
    _, there = link
    channel = link[0].options.channel
    arm = CanArm("arm", ArmOptions(channel=channel))
    arm.values["joint_effort_limit"][:] = 5.0
    for role in ("life_cycle", "brakes"):
        arm.frames.state.fields.pop(role)
    arm._tells_state, arm._arm_state = False, LifeCycle.active
    for name in ("joint_velocity_limit", "joint_upper_limit"):
        arm.values[name][:] = 1.0
    arm.values["joint_lower_limit"][:] = -1.0
    arm.values["joint_effort_limit"][:] = 1.0
    there.serve()
    try:
        arm.configure()
        arm.check_start()
        arm.activate(lambda: False)
        there.pause()
        arm._drain()
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


def test_an_arm_that_tells_is_at_rest_once_it_says_so(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    arm._last_torque = np.full(N, 0.5)
    there.received.clear()
    for k in range(400):
        there.send()
        arm.ramp_down(k * 1e-3)
    assert not arm.at_rest  # it has not said so
    there.life = LifeCycle.inactive
    there.send()
    assert arm.ramp_down(0.4)
    assert arm.at_rest


def test_an_arm_in_a_stop_of_its_own_is_left_to_it(active: tuple[CanArm, ScriptedArm]) -> None:
    """Its own damped ramp must not be cut short by our brakes."""
    arm, there = active
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
    assert len(there.received) <= 1  # the answer to the frame that told it


def test_a_state_that_nobody_knows_is_a_fault(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    there.send(life_cycle=(7.0,))
    with pytest.raises(SafeStop, match="went to a state of the unknown number 7 by itself"):
        arm.read()


def test_frames_that_hold_unequal_cycle_numbers_are_answered_by_the_narrower(active: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = active
    arm.frames.cycles = 256
    arm._cycle_number = 1617 % 256
    there.send(cycle=1618, echoed_cycle=(float(1617 % 256),))
    arm.read()
    arm.write()
    command = there.take()
    assert command is not None
    assert command["answered_cycle"][0] == 1618 % 256


def test_a_claim_is_kept_while_others_take_their_time(link: tuple[CanArm, ScriptedArm]) -> None:
    arm, there = link
    there.serve()
    arm.configure()
    there.pause()
    there.take()
    there.received.clear()
    there.send()
    arm.stay()
    command = there.take()
    assert command is not None
    assert (command["mode"][0], command["controller"][0]) == (Mode.idle, arm.controller)


@pytest.mark.parametrize(("ours", "refused"), [(1.0, False), (0.5, False), (1.1, True)])
def test_speeds_and_torques_may_be_narrower_than_the_arms_own_but_not_wider(
    link: tuple[CanArm, ScriptedArm], ours: float, refused: bool
) -> None:
    arm, there = link
    there.serve()
    for name in ("joint_effort_limit", "joint_velocity_limit"):
        arm.values[name][:] = ours
    if refused:
        with pytest.raises(DeviceError, match=r"its joint velocity limit of joint 1 is 1 rad/s, .* robot has 1\.1 rad/s"):
            arm.configure()
    else:
        arm.configure()
