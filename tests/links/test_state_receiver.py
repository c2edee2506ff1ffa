"""Reception of state frames: limits of a wait, and other senders, without a clock or a bus."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import can
import pytest

from freeflyer_adapters.arm.frames import ArmFrames, FrameMapping, Mode
from freeflyer_adapters.arm.state_receiver import FOREIGN, MOST_FRAMES, WITHIN, Numbers, StateFrames
from freeflyer_adapters.can.link import Sender
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.environment import Environment

N = 6
READING = 1_000
"""Duration of a clock reading [ns]."""


@cache
def frames() -> ArmFrames:
    return ArmFrames(FrameMapping(), N)


class Time(Environment):
    """Simulated clock: advances at each reading, and while the bus waits."""

    def __init__(self) -> None:
        self.now = 1_000_000_000

    def monotonic_ns(self) -> int:
        self.now += READING
        return self.now


class Bus:
    """Test double of a bus that returns the frames in `coming`; None: a timeout.

    `each`: duration of a reception [ns].
    """

    def __init__(self, time: Time, each: int = 0) -> None:
        self.time, self.each = time, each
        self.coming: Iterator[can.Message | can.CanError | None] = iter(())
        self.taken = 0

    def recv(self, timeout: float | None = None) -> can.Message | None:
        found = next(self.coming, None)
        if isinstance(found, can.CanError):
            raise found
        if found is None:
            self.time.now += round((timeout or 0.0) * 1e9)
            return None
        self.taken += 1
        self.time.now += self.each
        return found

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        pass


class Here:
    """Host side of the bus, with the state frames that it has received."""

    def __init__(self, each: int = 0) -> None:
        self.time = Time()
        self.bus = Bus(self.time, each)
        self.taken: list[tuple[Numbers, int, int]] = []
        self.uses = True
        self.sender = Sender(self.bus, frames().command)
        with environment.within(self.time):
            self.states = StateFrames(self.bus, frames(), self.sender, self.take)  # type: ignore[arg-type]

    def take(self, numbers: Numbers, now: int, empty_at: int) -> bool:
        self.taken.append((numbers, now, empty_at))
        return self.uses

    def wait(self, timeout: float, *coming: can.Message | can.CanError | None) -> bool:
        self.bus.coming = iter(coming)
        return self.states.wait(timeout)


@pytest.fixture
def here() -> Here:
    return Here()


class Node:
    """Another node: returns the frames that it sends."""

    def __init__(self, send: Callable[[], object] | None = None) -> None:
        self.sent: list[can.Message] = []
        self.states, self.commands = Sender(self, frames().state), Sender(self, frames().command)
        self.cycle = 0

    def send(self, message: can.Message) -> None:
        self.sent.append(message)

    def state(self, **values: Any) -> can.Message:
        self.cycle += 1
        self.states.send({"cycle": (float(self.cycle),), **values})
        return self.sent[-1]

    def command(self, number: int) -> can.Message:
        self.commands.send({"controller": (float(number),), "mode": (float(Mode.torque),)})
        return self.sent[-1]


def other() -> can.Message:
    return can.Message(arbitration_id=0x7AB, is_extended_id=False, data=b"12345678")


def flood() -> Iterator[can.Message]:
    while True:
        yield other()


# The newest state frame


def test_the_newest_of_several_is_taken_last(here: Here) -> None:
    arm = Node()
    assert here.wait(0.001, *[arm.state() for _ in range(3)])
    assert [numbers["cycle"][0] for numbers, _, _ in here.taken] == [1.0, 2.0, 3.0]


def test_a_wait_without_frames_lasts_for_its_timeout(here: Here) -> None:
    start = here.time.now
    assert not here.wait(0.005)
    assert here.time.now - start == pytest.approx(5_000_000, abs=10 * READING)


def test_an_unused_frame_does_not_end_the_wait(here: Here) -> None:
    here.uses = False
    start = here.time.now
    assert not here.wait(0.005, Node().state())
    assert len(here.taken) == 1
    assert here.time.now - start >= 5_000_000


def test_a_frame_is_newer_than_the_last_empty_receive_buffer(here: Here) -> None:
    arm = Node()
    assert here.wait(0.001, arm.state(), None)
    empty_at_last = here.time.now
    here.time.now += 50_000_000
    assert here.wait(0.001, arm.state(), arm.state(), None)
    for _, now, empty_at in here.taken[1:]:
        assert empty_at == pytest.approx(empty_at_last, abs=5 * READING)
        assert now > empty_at + 50_000_000


def test_a_failed_reception_does_not_count_as_an_empty_bus(here: Here) -> None:
    here.bus.each = 1_000_000
    assert here.wait(0.001, can.CanOperationError("bus off"), Node().state())
    assert here.taken[0][2] == 0
    assert here.states.error == "bus off"


# Bounds


@pytest.mark.parametrize("timeout", [0.0, 0.001, 0.0015])
def test_a_flood_of_other_frames_does_not_extend_a_wait(timeout: float) -> None:
    here = Here(each=50_000)
    here.bus.coming = flood()
    start = here.time.now
    assert not here.states.wait(timeout)
    # After the timeout, a wait may still read up to MOST_FRAMES frames.
    assert (
        here.time.now - start
        <= max(round(timeout * 1e9), MOST_FRAMES * 50_000) + MOST_FRAMES * 5 * READING
    )
    assert here.states.others == here.bus.taken


def test_a_long_wait_in_a_flood_lasts_for_its_timeout() -> None:
    here = Here(each=50_000)
    here.bus.coming = flood()
    start = here.time.now
    assert not here.states.wait(0.02)
    assert here.time.now - start == pytest.approx(20_000_000, abs=60_000)


def test_a_wait_with_timeout_zero_reads_64_frames_at_most(here: Here) -> None:
    here.bus.coming = flood()
    assert not here.states.wait(0.0)
    assert here.bus.taken == MOST_FRAMES == 64


@pytest.mark.parametrize("before", [0, 10, 63])
def test_a_wait_with_a_state_frame_reads_64_frames_at_most(here: Here, before: int) -> None:
    arm = Node()

    def coming() -> Iterator[can.Message]:
        yield from (other() for _ in range(before))
        yield arm.state()
        yield from flood()

    here.bus.coming = coming()
    assert here.states.wait(1.0)
    assert here.bus.taken == MOST_FRAMES
    assert not here.states.wait(0.0)
    assert here.bus.taken == 2 * MOST_FRAMES


def test_a_wait_reads_more_than_64_other_frames_before_a_state_frame(here: Here) -> None:
    arm = Node()
    assert here.wait(1.0, *[other() for _ in range(200)], arm.state(), other())
    assert here.bus.taken == 201


def test_failed_receptions_do_not_extend_a_wait(here: Here) -> None:
    def coming() -> Iterator[can.CanError]:
        while True:
            yield can.CanOperationError("the controller is off")

    here.bus.coming = coming()
    start = here.time.now
    assert not here.states.wait(0.001)
    assert here.time.now - start <= 1_000_000 + 10 * READING
    assert here.states.error == "the controller is off"


def test_discarding_pending_frames_is_bounded(here: Here) -> None:
    here.bus.coming = flood()
    here.states.drain()
    assert here.bus.taken == 16 * MOST_FRAMES


# Other senders on the bus


def test_one_arm_and_one_controller_are_no_problem(here: Here) -> None:
    arm = Node()
    for _ in range(100):
        here.wait(0.001, arm.state())
    assert here.states.problem is None


def test_two_arms_are_a_problem_with_both_counters(here: Here) -> None:
    first, second = Node(), Node()
    for _ in range(100):
        second.state()
    for _ in range(50):
        here.wait(0.001, first.state(), second.state())
    assert here.states.problem is not None
    assert (
        "two senders send the state frame ArmState (0x181), with the counters "
        in here.states.problem
    )
    assert "two arms are on this channel" in here.states.problem


@pytest.mark.parametrize(
    ("frames", "is_problem"), [(160, False), (264, False), (265, True), (320, True)]
)
def test_two_arms_are_a_problem_by_the_rate_of_their_frames(
    here: Here, frames: int, is_problem: bool
) -> None:
    """If the frames of two arms arrive in bursts of 20, their counters do not show two arms."""
    one, other = Node(), Node()
    for _ in range(20):
        here.wait(0.0, *(one.state() for _ in range(20)))
        here.wait(0.0, *(other.state(joint_position=[0.1] * 6) for _ in range(20)))
    assert not here.states.receiver.senders.found
    problem = here.states.rate_problem(frames, cycles=160.0)
    assert (problem is not None) == is_problem
    if problem is not None:
        assert f"{frames} frames in 160 cycles: two arms are on this channel" in problem


def test_command_frames_of_another_controller_are_a_problem_with_its_session(here: Here) -> None:
    arm, foreign = Node(), Node()
    for k in range(FOREIGN):
        assert here.states.problem is None, k
        here.wait(0.001, arm.state(), foreign.command(4711))
    assert here.states.problem == (
        "another controller sends the command frame ArmCommand (0x101), of session 4711; stop the other controller first"
    )


def test_command_frames_are_a_problem_without_any_state_frame(here: Here) -> None:
    foreign = Node()
    for _ in range(FOREIGN):
        here.wait(0.001, foreign.command(4711))
    assert here.states.problem is not None


def test_single_command_frames_far_apart_are_no_problem(here: Here) -> None:
    """Last frames of a controller that has just stopped are not a second controller."""
    arm, foreign = Node(), Node()
    for _ in range(5):
        for _ in range(WITHIN // 2):
            here.wait(0.001, arm.state())
        here.wait(0.001, foreign.command(4711))
    assert here.states.problem is None


def test_damaged_command_frames_are_ignored(here: Here) -> None:
    arm, foreign = Node(), Node()
    for _ in range(10):
        message = foreign.command(4711)
        message.data[10] ^= 1
        here.wait(0.001, arm.state(), message)
    assert here.states.problem is None


@pytest.mark.parametrize("is_rx", [False, True])
def test_own_command_frames_that_the_interface_echoes_are_no_problem(
    here: Here, is_rx: bool
) -> None:
    """Some interfaces mark an own frame (`is_rx` is False), and others do not."""
    arm = Node()
    for k in range(100):
        here.sender.send({"controller": (7.0,), "answered_cycle": (float(k),)})
        own = can.Message(
            arbitration_id=frames().command.identifier,
            is_extended_id=False,
            is_fd=True,
            is_rx=is_rx,
            data=here.sender.recent[-1],
        )
        here.wait(0.001, arm.state(), own)
    assert here.states.problem is None


def test_frames_that_the_interface_marks_as_own_are_no_problem_at_any_age(
    here: Here,
) -> None:
    arm, earlier = Node(), Node()
    for _ in range(10):
        message = earlier.command(7)
        message.is_rx = False
        here.wait(0.001, arm.state(), message)
    assert here.states.problem is None


def test_frames_of_another_controller_are_detected_between_echoed_own_frames(
    here: Here,
) -> None:
    arm, foreign = Node(), Node()
    for k in range(FOREIGN):
        here.sender.send({"controller": (7.0,), "answered_cycle": (float(k),)})
        own = can.Message(
            arbitration_id=frames().command.identifier,
            is_extended_id=False,
            is_fd=True,
            data=here.sender.recent[-1],
        )
        here.wait(0.001, arm.state(), own, foreign.command(4711))
    assert here.states.problem is not None


def test_frames_of_other_identifiers_are_counted_and_no_problem(here: Here) -> None:
    arm = Node()
    for _ in range(50):
        here.wait(0.001, arm.state(), other(), other())
    assert here.states.others == 100
    assert here.states.problem is None
