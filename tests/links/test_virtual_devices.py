"""The logic of the virtual arm and base: watchdogs, sessions and stops, without clock and link."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer_adapters.arm.frames import Mode
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.device.ramp_down import RampDown
from freeflyer_adapters.facility.arm_logic import ArmLogic, Command
from freeflyer_adapters.facility.base_logic import BaseLogic
from freeflyer_adapters.facility.settings import FacilitySettings

N = 6
OURS, OTHER = 11, 22
STILL = np.zeros(N)
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def logic(
    watchdog: int = 4, silence: int = 100, cycles: int = 2**24, implicit: bool = False
) -> ArmLogic:
    ramp = RampDown(time=0.25, damping=5.0)
    return ArmLogic(
        N,
        cycle=1e-3,
        watchdog=watchdog,
        silence=silence,
        ramp=ramp,
        cycles=cycles,
        implicit=implicit,
    )


def command(
    arm: ArmLogic,
    mode: Mode = Mode.torque,
    controller: int = OURS,
    behind: int = 0,
    torque: float = 1.0,
) -> Command:
    return Command(
        controller=controller,
        mode=mode,
        answered=(arm.cycle - behind) % arm.cycles,
        torque=np.full(N, torque),
    )


def claimed(arm: ArmLogic, controller: int = OURS) -> ArmLogic:
    arm.begin([command(arm, Mode.reset, controller)], STILL)
    assert arm.controller == controller
    return arm


def activated(arm: ArmLogic, controller: int = OURS) -> ArmLogic:
    """Claim and activate an arm, and command its first torque."""
    claimed(arm, controller)
    arm.begin([command(arm, Mode.activate, controller)], STILL)
    arm.begin([command(arm, Mode.torque, controller)], STILL)
    assert arm.life.now is LifeCycle.active
    return arm


def active(watchdog: int = 4) -> ArmLogic:
    arm = logic(watchdog)
    arm.begin([], STILL)
    return activated(arm)


def braked(arm: ArmLogic) -> ArmLogic:
    """Send no commands until the brakes are engaged."""
    while not arm.braked:
        arm.begin([], STILL)
    return arm


def released(arm: ArmLogic) -> ArmLogic:
    """Send no commands until the arm accepts commands from no controller."""
    while arm.controller:
        arm.begin([], STILL)
    return arm


def test_an_arm_is_braked_without_torque_until_it_is_activated() -> None:
    arm = logic()
    claimed(arm)
    for mode in (Mode.idle, Mode.reset, Mode.torque):
        for _ in range(10):
            arm.begin([command(arm, mode)], STILL)
            assert arm.braked
            assert not arm.torque.any()
            assert arm.controller == OURS
    arm.begin([command(arm, Mode.activate)], STILL)
    assert not arm.braked
    assert not arm.torque.any()
    assert arm.echoed == arm.cycle - 1
    arm.begin([command(arm)], STILL)
    assert (arm.torque == 1.0).all()
    assert arm.echoed == arm.cycle - 1
    arm.begin([command(arm, controller=OTHER)], STILL)
    assert arm.echoed == arm.cycle - 2, "a command that is not used is not echoed"


@pytest.mark.parametrize("watchdog", [1, 2, 4])
def test_without_commands_the_arm_is_in_safe_stop_one_cycle_after_its_watchdog(
    watchdog: int,
) -> None:
    arm = active(watchdog)
    start = arm.cycle
    while arm.life.now is LifeCycle.active:
        arm.begin([], STILL)
    # The cycles are counted from the last answered state frame.
    assert arm.cycle - (start - 1) == watchdog + 1
    assert arm.lost == watchdog


def test_the_default_watchdog_leads_to_safe_stop_within_five_cycles() -> None:
    assert FacilitySettings().arm_watchdog_cycles + 1 <= 5


def test_safe_stop_ramps_the_torque_down_with_damping_and_then_brakes() -> None:
    arm = active()
    while arm.life.now is LifeCycle.active:
        arm.begin([], np.full(N, 0.5))
    # The torque is against the motion: 1 N m - 5 N m s/rad * 0.5 rad/s.
    assert arm.torque == pytest.approx(np.full(N, -1.5), abs=0.01)
    for _ in range(600):
        arm.begin([], np.full(N, 0.5))
    assert arm.braked
    assert not arm.torque.any()
    assert arm.life.now is LifeCycle.safe_stop


def test_an_old_command_does_not_reset_the_watchdog() -> None:
    arm = active()
    for _ in range(10):
        arm.begin([command(arm, behind=4, torque=9.0)], STILL)
        assert (np.abs(arm.torque) <= 1.0).all(), "its torque was used"
    assert arm.life.now is LifeCycle.safe_stop


def test_one_late_command_is_used_and_counted() -> None:
    arm = active()
    arm.begin([command(arm, behind=1, torque=2.0)], STILL)
    assert arm.life.now is LifeCycle.active
    assert (arm.torque == 2.0).all()
    assert arm.lost == 1
    arm.begin([command(arm)], STILL)
    assert arm.lost == 1


def test_another_controller_is_rejected_until_the_first_one_sends_nothing() -> None:
    arm = active()
    for _ in range(3):
        arm.begin([command(arm, torque=1.0), command(arm, controller=OTHER, torque=9.0)], STILL)
        assert (arm.torque == 1.0).all()
    assert arm.foreign == 3
    for _ in range(99):
        arm.begin([command(arm, Mode.reset, controller=OTHER)], STILL)
        assert arm.controller == OURS
    arm.begin([], STILL)
    assert arm.controller == 0
    assert arm.session_is_over
    claimed(braked(arm), OTHER)


def test_only_the_claim_of_a_new_session_number_leaves_safe_stop() -> None:
    arm = braked(active())
    for mode in Mode:
        arm.begin([command(arm, mode)], STILL)
        assert arm.life.now is LifeCycle.safe_stop
    released(arm)
    assert arm.life.now is LifeCycle.safe_stop
    claimed(arm, OTHER)
    assert arm.life.now is LifeCycle.inactive
    assert arm.braked


def test_a_brake_command_makes_an_active_arm_inactive() -> None:
    arm = active()
    arm.begin([command(arm, Mode.brake)], STILL)
    assert arm.life.now is LifeCycle.inactive
    assert arm.braked


def test_a_failed_arm_brakes_and_reports_a_fault() -> None:
    arm = active()
    arm.fail("a drive is too hot")
    assert arm.braked
    assert arm.life.now is LifeCycle.fault


commands = st.tuples(
    st.sampled_from([*Mode, Mode.reset, Mode.activate, None]),
    st.sampled_from([0, OURS, OURS, OTHER]),
    st.sampled_from([0, 0, 0, 1, 2, 3, 4, -1, 10]),
    st.floats(-50.0, 50.0),
)


@given(st.lists(st.lists(commands, max_size=3), max_size=80), st.booleans())
def test_only_the_activation_of_a_new_echoed_session_activates_for_any_commands(
    cycles: list[list[tuple[Mode | None, int, int, float]]], is_claimed: bool
) -> None:
    watchdog = 4
    arm = logic(watchdog, silence=10)
    if is_claimed:
        claimed(arm)
    echoed = [arm.controller]  # in each state frame, the latest one first
    used: set[int] = set()
    for sent in cycles:
        was, controller = arm.life.now, arm.controller
        arm.begin(
            [
                Command(
                    controller=c,
                    mode=m,
                    answered=(arm.cycle - behind) % 2**24,
                    torque=np.full(N, torque),
                )
                for m, c, behind, torque in sent
            ],
            STILL,
        )
        if arm.life.now is LifeCycle.active and was is not LifeCycle.active:
            activations = [
                (c, behind)
                for m, c, behind, _ in sent
                if m is Mode.activate and c == controller != 0
            ]
            answered = [
                b for c, b in activations if 0 <= b < watchdog and echoed[: b + 1] == [c] * (b + 1)
            ]
            assert answered, "another command activated the arm"
            assert controller not in used
        if was is LifeCycle.active and arm.life.now is not LifeCycle.active:
            used.add(controller)
        echoed.insert(0, arm.controller)


@given(st.lists(st.lists(commands, max_size=3), max_size=80), st.booleans())
def test_a_braked_arm_has_no_torque_and_an_inactive_one_is_braked_for_any_commands(
    cycles: list[list[tuple[Mode | None, int, int, float]]], is_active: bool
) -> None:
    arm = logic(silence=10)
    if is_active:
        activated(arm)
    for sent in cycles:
        arm.begin(
            [
                Command(
                    controller=c,
                    mode=m,
                    answered=(arm.cycle - behind) % 2**24,
                    torque=np.full(N, torque),
                )
                for m, c, behind, torque in sent
            ],
            STILL,
        )
        if arm.braked:
            assert not arm.torque.any()
        if arm.life.now is not LifeCycle.active and arm.life.now is not LifeCycle.safe_stop:
            assert arm.braked
        if arm.life.now is LifeCycle.active:
            assert not arm.braked


def test_the_cycle_number_wraps_around() -> None:
    arm = logic()
    arm.cycle = 2**24 - 4
    activated(arm)
    assert arm.cycle == 2**24 - 1
    for _ in range(5):
        arm.begin([command(arm)], STILL)
        assert arm.life.now is LifeCycle.active
        assert arm.lost == 0


# Sessions and activation of the arm


@pytest.mark.parametrize("mode", [Mode.idle, Mode.torque, Mode.brake, Mode.activate, None])
def test_only_a_reset_claims(mode: Mode | None) -> None:
    arm = logic()
    for _ in range(5):
        arm.begin([Command(controller=OURS, mode=mode, answered=arm.cycle, torque=STILL)], STILL)
    assert arm.controller == 0
    assert arm.foreign == 5
    assert arm.life.now is LifeCycle.inactive


def test_session_number_zero_claims_nothing() -> None:
    arm = logic()
    arm.begin([command(arm, Mode.reset, controller=0)], STILL)
    assert arm.controller == 0
    assert arm.foreign == 1


def test_an_arm_with_a_session_rejects_another_claim() -> None:
    arm = claimed(logic())
    arm.begin([command(arm, Mode.reset, controller=OTHER)], STILL)
    assert arm.controller == OURS
    assert arm.foreign == 1


def test_an_arm_that_is_not_braked_yet_can_be_claimed_and_stays_in_safe_stop() -> None:
    """The claim does not interrupt the ramp-down."""
    arm = released(active())
    assert not arm.braked
    while not arm.braked:
        arm.begin([command(arm, Mode.reset, controller=OTHER)], STILL)
        assert arm.controller == OTHER
        assert arm.life.now is LifeCycle.safe_stop
    arm.begin([command(arm, Mode.reset, controller=OTHER)], STILL)
    assert arm.life.now is LifeCycle.inactive


def by_silence(arm: ArmLogic) -> None:
    braked(arm)


def by_brakes(arm: ArmLogic) -> None:
    arm.begin([command(arm, Mode.brake)], STILL)


def by_fault(arm: ArmLogic) -> None:
    arm.fail("a drive is too hot")


@pytest.mark.parametrize("leave", [by_silence, by_brakes, by_fault])
def test_leaving_active_in_any_way_uses_up_the_session_number(
    leave: Callable[[ArmLogic], None],
) -> None:
    arm = active()
    leave(arm)
    left = arm.life.now
    assert left is not LifeCycle.active
    for mode in (Mode.reset, Mode.activate, Mode.torque):
        arm.begin([command(arm, mode)], STILL)
        assert arm.life.now is left
    released(arm)
    arm.begin([command(arm, Mode.reset)], STILL)
    assert arm.controller == 0
    assert arm.life.now is left
    activated(arm, OTHER)


def test_a_brake_command_before_the_activation_uses_up_the_session_number() -> None:
    arm = claimed(logic())
    arm.begin([command(arm, Mode.brake)], STILL)
    arm.begin([command(arm, Mode.activate)], STILL)
    assert arm.life.now is LifeCycle.inactive
    assert arm.ignored == 1


def test_a_session_number_that_was_only_claimed_can_be_claimed_again() -> None:
    arm = released(claimed(logic()))
    activated(arm)


def test_used_session_numbers_and_the_cycle_number_are_kept_between_sessions() -> None:
    arm = active()
    by_brakes(arm)
    following = arm.again()
    assert following.cycle == arm.cycle
    assert following.life.now is LifeCycle.inactive
    following.begin([command(following, Mode.reset)], STILL)
    assert following.controller == 0
    activated(following, OTHER)


def test_the_oldest_used_session_number_is_dropped_first() -> None:
    ramp = RampDown(time=0.25, damping=5.0)
    arm = ArmLogic(N, cycle=1e-3, watchdog=4, silence=10, ramp=ramp, used=deque([1, 2], maxlen=2))
    by_brakes(activated(arm))
    assert list(arm.used) == [2, OURS]


def test_an_activation_in_the_same_cycle_as_its_claim_is_ignored() -> None:
    """No state frame has echoed the number yet, and an activation must answer the echo."""
    arm = logic()
    arm.begin([command(arm, Mode.reset), command(arm, Mode.activate)], STILL)
    assert arm.life.now is LifeCycle.inactive
    assert arm.ignored == 1


def test_an_activation_that_answers_a_state_frame_before_the_echo_is_ignored() -> None:
    arm = logic()
    arm.begin([], STILL)
    claimed(arm)
    arm.begin([command(arm, Mode.activate, behind=1)], STILL)
    assert arm.life.now is LifeCycle.inactive
    arm.begin([command(arm, Mode.activate, behind=1)], STILL)
    assert arm.life.now is LifeCycle.active


@pytest.mark.parametrize("behind", range(7))
def test_an_activation_must_be_younger_than_the_watchdog(behind: int) -> None:
    arm = claimed(logic(watchdog=4))
    for _ in range(20):
        arm.begin([command(arm, Mode.idle)], STILL)
    arm.begin([command(arm, Mode.activate, behind=behind)], STILL)
    assert (arm.life.now is LifeCycle.active) is (behind < 4)
    assert arm.ignored == (behind >= 4)


def test_an_activation_of_another_session_number_is_ignored() -> None:
    arm = claimed(logic())
    arm.begin([command(arm, Mode.activate, controller=OTHER)], STILL)
    assert arm.life.now is LifeCycle.inactive
    assert arm.foreign == 1


def test_an_activation_of_an_active_arm_neither_changes_the_torque_nor_resets_the_watchdog() -> (
    None
):
    arm = active()
    for _ in range(3):
        arm.begin([command(arm, Mode.activate, torque=9.0)], STILL)
        assert (arm.torque == 1.0).all()
    assert arm.life.now is LifeCycle.active
    arm.begin([command(arm, Mode.activate, torque=9.0)], STILL)
    assert arm.life.now is LifeCycle.safe_stop
    assert arm.ignored == 0


def test_torque_outside_active_is_ignored_and_counted() -> None:
    arm = claimed(logic())
    for k in range(1, 4):
        arm.begin([command(arm)], STILL)
        assert arm.ignored == k
    assert arm.braked
    by_brakes(activated(released(arm)))
    before = arm.ignored
    arm.begin([command(arm)], STILL)
    assert arm.ignored == before + 1
    assert arm.life.now is LifeCycle.inactive


def test_a_reset_of_an_active_arm_changes_nothing() -> None:
    arm = active()
    arm.begin([command(arm, Mode.reset), command(arm)], STILL)
    assert arm.life.now is LifeCycle.active
    assert not arm.used


@pytest.mark.parametrize("torque", [5.1, -5.1, np.nan])
def test_a_command_beyond_the_effort_limit_is_counted_and_not_used(torque: float) -> None:
    arm = active()
    arm.effort = np.full(N, 5.0)
    arm.begin([command(arm, torque=torque)], STILL)
    assert (arm.torque == 1.0).all()
    assert arm.excessive == 1
    claiming = claimed(logic())
    claiming.effort = np.full(N, 5.0)
    claiming.begin([command(claiming, Mode.activate, torque=torque)], STILL)
    assert claiming.life.now is LifeCycle.inactive


# An arm without session numbers and without the mode `activate`


@pytest.mark.parametrize("mode", list(Mode))
def test_an_implicit_arm_accepts_the_first_controller(mode: Mode) -> None:
    arm = logic(implicit=True)
    arm.begin([command(arm, mode)], STILL)
    assert arm.controller == OURS
    arm.begin([command(arm, mode, controller=OTHER)], STILL)
    assert arm.controller == OURS
    assert arm.foreign == 1


def test_an_implicit_arm_is_activated_by_torque_and_applies_it_immediately() -> None:
    arm = logic(implicit=True)
    arm.begin([command(arm, Mode.idle)], STILL)
    assert arm.braked
    arm.begin([command(arm)], STILL)
    assert arm.life.now is LifeCycle.active
    assert (arm.torque == 1.0).all()


def test_an_implicit_arm_is_activated_again_after_brakes_and_after_a_reset() -> None:
    """An implicit arm cannot reject these commands; an explicit arm can."""
    arm = logic(implicit=True)
    arm.begin([command(arm)], STILL)
    by_brakes(arm)
    arm.begin([command(arm)], STILL)
    assert arm.life.now is LifeCycle.active
    braked(arm)
    assert arm.life.now is LifeCycle.safe_stop
    arm.begin([command(arm)], STILL)
    assert arm.life.now is LifeCycle.safe_stop
    arm.begin([command(arm, Mode.reset)], STILL)
    assert arm.life.now is LifeCycle.inactive


def test_a_torque_frame_as_old_as_the_watchdog_does_not_activate_an_implicit_arm() -> None:
    arm = logic(implicit=True)
    for _ in range(10):
        arm.begin([], STILL)
    arm.begin([command(arm, behind=4)], STILL)
    assert arm.life.now is LifeCycle.inactive
    arm.begin([command(arm, behind=3)], STILL)
    assert arm.life.now is LifeCycle.active


# The base


def base() -> BaseLogic:
    made = BaseLogic(period=1e-3, watchdog=20, silence=100, jump=(0.01, 0.02))
    made.hold(np.zeros(3), IDENTITY)
    return made


POSE = (np.zeros(3), IDENTITY)


def test_the_base_holds_its_pose_when_set_points_stop() -> None:
    robot = base()
    for k in range(5):
        assert robot.take(np.full(3, 0.001 * k), IDENTITY, np.full(6, 0.1), POSE)
        robot.tick()
    for _ in range(20):
        robot.tick()
    assert robot.life.now is LifeCycle.safe_stop
    assert not robot.velocity.any()
    assert robot.position == pytest.approx(np.full(3, 0.004))


def test_a_first_set_point_far_away_is_rejected() -> None:
    robot = base()
    assert not robot.take(np.array([0.02, 0.0, 0.0]), IDENTITY, np.zeros(6), POSE)
    assert not robot.take(np.zeros(3), np.array([0.1, 0.0, 0.0, 0.995]), np.zeros(6), POSE)
    assert robot.life.now is LifeCycle.inactive
    assert robot.refused == 2
    assert robot.take(np.array([0.009, 0.0, 0.0]), IDENTITY, np.zeros(6), POSE)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_set_point_that_is_not_finite_is_rejected_and_the_last_one_held(bad: float) -> None:
    robot = base()
    robot.take(np.full(3, 0.001), IDENTITY, np.zeros(6), POSE)
    assert not robot.take(np.array([bad, 0.0, 0.0]), IDENTITY, np.zeros(6), POSE)
    assert not robot.take(np.zeros(3), np.zeros(4), np.zeros(6), POSE)
    assert robot.position == pytest.approx(np.full(3, 0.001))
    assert robot.refused == 2


A, B = b"a" * 16, b"b" * 16


def taken(robot: BaseLogic, publisher: bytes = A, x: float = 0.0, delay: float = 0.0) -> bool:
    return robot.take(np.array([x, 0.0, 0.0]), IDENTITY, np.zeros(6), POSE, publisher, delay)


def quiet(robot: BaseLogic, calls: int = 30) -> None:
    for _ in range(calls):
        robot.tick()


def test_a_publisher_can_activate_the_base_only_once() -> None:
    robot = base()
    assert taken(robot, A)
    quiet(robot)
    assert robot.life.now is LifeCycle.safe_stop
    for _ in range(3):
        assert not taken(robot, A)
        robot.tick()
    assert robot.life.now is LifeCycle.safe_stop
    assert taken(robot, B)
    assert robot.life.now is LifeCycle.active
    assert robot.publisher == B
    quiet(robot)
    assert not taken(robot, A)
    assert not taken(robot, B)


def test_an_active_base_only_accepts_set_points_of_its_publisher() -> None:
    robot = base()
    taken(robot, A)
    for _ in range(21):
        assert not taken(robot, B)
        robot.tick()
    assert robot.life.now is LifeCycle.safe_stop, "set points of another publisher kept it active"
    assert robot.refused == 21
    assert taken(robot, B), "a publisher that was only rejected is not used up"


def test_used_publishers_are_kept_between_sessions() -> None:
    used: deque[bytes] = deque(maxlen=2)
    robot = BaseLogic(period=1e-3, watchdog=20, silence=100, jump=(0.01, 0.02), used=used)
    robot.hold(*POSE)
    taken(robot, A)
    quiet(robot)
    following = BaseLogic(period=1e-3, watchdog=20, silence=100, jump=(0.01, 0.02), used=used)
    following.hold(*POSE)
    assert not taken(following, A)
    assert following.life.now is LifeCycle.inactive
    assert taken(following, B)


def test_a_set_point_with_a_delay_longer_than_the_watchdog_is_rejected() -> None:
    robot = base()
    assert not taken(robot, delay=0.0201)
    assert robot.life.now is LifeCycle.inactive
    assert taken(robot, delay=0.0199)
    assert not taken(robot, x=0.001, delay=0.0201)
    assert not robot.position.any()
    assert robot.refused == 2


def test_set_points_in_time_reset_the_watchdog() -> None:
    robot = base()
    for _ in range(5):
        assert taken(robot)
        quiet(robot, 20)
    assert robot.life.now is LifeCycle.active
    robot.tick()
    assert robot.life.now is LifeCycle.safe_stop


def test_late_set_points_do_not_reset_the_watchdog() -> None:
    robot = base()
    taken(robot)
    for _ in range(21):
        taken(robot, delay=0.1)
        robot.tick()
    assert robot.life.now is LifeCycle.safe_stop


def test_a_set_point_far_from_the_previous_one_is_rejected() -> None:
    robot = base()
    taken(robot, x=0.009)
    assert not taken(robot, x=0.02)
    assert taken(robot, x=0.018)
    assert not taken(robot, x=0.0)


def test_a_new_publisher_far_from_the_base_does_not_leave_safe_stop() -> None:
    robot = base()
    taken(robot, A)
    quiet(robot)
    assert not taken(robot, B, x=0.02)
    assert robot.life.now is LifeCycle.safe_stop
    assert not taken(robot, B, delay=0.1)
    assert robot.life.now is LifeCycle.safe_stop
    assert taken(robot, B)


def test_a_command_that_answers_an_older_cycle_than_the_last_command_is_not_used() -> None:
    arm = active()
    newer, older = command(arm, torque=1.0), command(arm, behind=1, torque=9.0)
    arm.begin([newer, older], STILL)
    assert (arm.torque == 1.0).all()


@pytest.mark.parametrize("cycles", [64, 256])
def test_a_short_cycle_number_wraps_around_repeatedly(cycles: int) -> None:
    arm = activated(logic(silence=500, cycles=cycles))
    for _ in range(1000):
        arm.begin([command(arm)], STILL)
        assert 0 <= arm.cycle < cycles
    assert arm.life.now is LifeCycle.active
    assert arm.lost == 0
    for _ in range(3):
        arm.begin([], STILL)
    assert arm.life.now is LifeCycle.active
    arm.begin([], STILL)
    assert arm.life.now is LifeCycle.safe_stop
    for _ in range(600):
        arm.begin([], STILL)
    assert arm.braked
    assert arm.controller == 0


# Proof that set points arrive in time


def proving() -> BaseLogic:
    made = BaseLogic(period=1e-3, watchdog=20, silence=100, jump=(0.01, 0.02), proof=40)
    made.hold(np.zeros(3), IDENTITY)
    return made


def arrive(
    robot: BaseLogic, calls: int, every: int = 4, late: float = 0.0, stamps_per_call: float = 1e-3
) -> None:
    """Send a set point in every n-th call (n is `every`) until `calls` calls are over.

    `late` [s]: delay of the set points. `stamps_per_call` [s]: advance of the stamps per call.
    """
    start = robot._calls
    while robot._calls - start < calls:
        if (robot._calls - start) % every == 0:
            robot.take(
                np.zeros(3),
                IDENTITY,
                np.zeros(6),
                POSE,
                b"one",
                0.0,
                (robot._calls - start) * stamps_per_call - late,
            )
        robot.tick()


def test_set_points_activate_after_arriving_at_the_rate_of_their_stamps_for_the_proof_time() -> (
    None
):
    robot = proving()
    arrive(robot, 40)
    assert robot.life.now is LifeCycle.inactive
    assert robot.refused == 0
    arrive(robot, 44)
    assert robot.life.now is LifeCycle.active


@pytest.mark.parametrize(
    ("every", "stamps_per_call"),
    [(21, 1e-3), (4, 0.4e-3), (4, 1.6e-3), (4, 0.0)],
    ids=["with gaps", "with growing delay", "in a burst", "with a frozen stamp"],
)
def test_set_points_that_do_not_arrive_at_the_rate_of_their_stamps_do_not_activate(
    every: int, stamps_per_call: float
) -> None:
    robot = proving()
    arrive(robot, 400, every=every, stamps_per_call=stamps_per_call)
    assert robot.life.now is LifeCycle.inactive


def test_two_set_points_with_a_long_gap_do_not_activate() -> None:
    robot = proving()
    arrive(robot, 1)
    for _ in range(10_000):
        robot.tick()
    robot.take(np.zeros(3), IDENTITY, np.zeros(6), POSE, b"one", 0.0, 10.001)
    assert robot.life.now is LifeCycle.inactive
