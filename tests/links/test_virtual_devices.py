"""What the virtual arm and base decide by themselves: watchdogs, whom they obey, how they stop. No clock, no wire."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer_adapters.arm.frames import Mode
from freeflyer_adapters.device import LifeCycle
from freeflyer_adapters.facility.arm_logic import ArmLogic, Command
from freeflyer_adapters.facility.base_logic import BaseLogic
from freeflyer_adapters.facility.settings import FacilitySettings
from freeflyer_adapters.ramp_down import RampDown

N = 6
OURS, OTHER = 11, 22
STILL = np.zeros(N)
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def logic(watchdog: int = 4, silence: int = 100) -> ArmLogic:
    return ArmLogic(N, cycle=1e-3, watchdog=watchdog, silence=silence, ramp=RampDown(time=0.25, damping=5.0))


def command(arm: ArmLogic, mode: Mode = Mode.torque, controller: int = OURS, behind: int = 0, torque: float = 1.0) -> Command:
    return Command(controller=controller, mode=mode, answered=arm.cycle - behind, torque=np.full(N, torque))


def active(watchdog: int = 4) -> ArmLogic:
    arm = logic(watchdog)
    arm.begin([], STILL)
    arm.begin([command(arm)], STILL)
    assert arm.life.now is LifeCycle.active
    return arm


def test_it_is_braked_without_torque_until_a_controller_takes_over() -> None:
    arm = logic()
    for _ in range(10):
        arm.begin([command(arm, Mode.idle)], STILL)
        assert arm.braked
        assert not arm.torque.any()
        assert arm.controller == OURS
    arm.begin([command(arm)], STILL)
    assert not arm.braked
    assert (arm.torque == 1.0).all()


@pytest.mark.parametrize("watchdog", [1, 2, 4])
def test_without_commands_it_is_in_safe_stop_within_its_watchdogs_cycles_plus_one(watchdog: int) -> None:
    arm = active(watchdog)
    begin = arm.cycle
    while arm.life.now is LifeCycle.active:
        arm.begin([], STILL)
    # Counted from the last state frame that was answered.
    assert arm.cycle - (begin - 1) == watchdog + 1
    assert arm.lost == watchdog


def test_the_default_watchdog_is_safe_within_five_cycles() -> None:
    assert FacilitySettings().arm_watchdog_cycles + 1 <= 5


def test_safe_stop_ramps_the_torque_down_against_the_motion_and_then_brakes() -> None:
    arm = active()
    while arm.life.now is LifeCycle.active:
        arm.begin([], np.full(N, 0.5))
    # Not only less torque, but one against the motion: 1 N m - 5 N m s/rad * 0.5 rad/s.
    assert arm.torque == pytest.approx(np.full(N, -1.5), abs=0.01)
    for _ in range(600):
        arm.begin([], np.full(N, 0.5))
    assert arm.braked
    assert not arm.torque.any()
    assert arm.life.now is LifeCycle.safe_stop


def test_a_command_that_is_too_old_does_not_keep_it_alive() -> None:
    arm = active()
    for _ in range(10):
        arm.begin([command(arm, behind=4)], STILL)
    assert arm.life.now is LifeCycle.safe_stop


def test_one_late_command_is_used_and_counted() -> None:
    arm = active()
    arm.begin([command(arm, behind=1, torque=2.0)], STILL)
    assert arm.life.now is LifeCycle.active
    assert (arm.torque == 2.0).all()
    assert arm.lost == 1
    arm.begin([command(arm)], STILL)
    assert arm.lost == 1


def test_another_controller_is_not_obeyed_until_the_first_is_silent() -> None:
    arm = active()
    for _ in range(3):
        arm.begin([command(arm, torque=1.0), command(arm, controller=OTHER, torque=9.0)], STILL)
        assert (arm.torque == 1.0).all()
    assert arm.strangers == 3
    for _ in range(102):
        arm.begin([], STILL)
    assert arm.controller == 0
    assert arm.session_is_over
    arm.begin([command(arm, Mode.idle, controller=OTHER)], STILL)
    assert arm.controller == OTHER


def test_safe_stop_is_left_by_reset_only() -> None:
    arm = active()
    while not arm.braked:
        arm.begin([], STILL)
    for mode in (Mode.torque, Mode.idle, Mode.brake):
        arm.begin([command(arm, mode)], STILL)
        assert arm.life.now is LifeCycle.safe_stop
    arm.begin([command(arm, Mode.reset)], STILL)
    assert arm.life.now is LifeCycle.inactive


def test_a_brake_command_ends_it_in_order() -> None:
    arm = active()
    arm.begin([command(arm, Mode.brake)], STILL)
    assert arm.life.now is LifeCycle.inactive
    assert arm.braked


def test_a_failed_arm_brakes_and_says_fault() -> None:
    arm = active()
    arm.fail("a drive is too hot")
    assert arm.braked
    assert arm.life.now is LifeCycle.fault


commands = st.tuples(
    st.sampled_from([*Mode, None]), st.sampled_from([0, OURS, OTHER]), st.integers(-3, 10), st.floats(-50.0, 50.0)
)


@given(st.lists(st.lists(commands, max_size=3), max_size=80))
def test_whatever_is_commanded_a_braked_arm_has_no_torque_and_an_inactive_one_is_braked(
    cycles: list[list[tuple[Mode | None, int, int, float]]],
) -> None:
    arm = logic(silence=10)
    for sent in cycles:
        arm.begin(
            [
                Command(controller=c, mode=m, answered=(arm.cycle - behind) % 2**24, torque=np.full(N, torque))
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


def test_the_cycle_number_runs_over() -> None:
    arm = logic()
    arm.cycle = 2**24 - 2
    arm.begin([], STILL)
    arm.begin([command(arm)], STILL)
    for _ in range(5):
        arm.begin([command(arm)], STILL)
        assert arm.life.now is LifeCycle.active
        assert arm.lost == 0


# The base


def base() -> BaseLogic:
    made = BaseLogic(period=1e-3, watchdog=20, silence=100, jump=(0.01, 0.02))
    made.hold(np.zeros(3), IDENTITY)
    return made


POSE = (np.zeros(3), IDENTITY)


def test_the_base_holds_its_place_when_set_points_stop() -> None:
    robot = base()
    for k in range(5):
        assert robot.take(np.full(3, 0.001 * k), IDENTITY, np.full(6, 0.1), POSE)
        robot.tick()
    for _ in range(20):
        robot.tick()
    assert robot.life.now is LifeCycle.safe_stop
    assert not robot.velocity.any()
    assert robot.position == pytest.approx(np.full(3, 0.004))


def test_a_first_set_point_far_away_is_refused() -> None:
    robot = base()
    assert not robot.take(np.array([0.02, 0.0, 0.0]), IDENTITY, np.zeros(6), POSE)
    assert not robot.take(np.zeros(3), np.array([0.1, 0.0, 0.0, 0.995]), np.zeros(6), POSE)
    assert robot.life.now is LifeCycle.inactive
    assert robot.refused == 2
    assert robot.take(np.array([0.009, 0.0, 0.0]), IDENTITY, np.zeros(6), POSE)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_set_point_that_is_no_number_is_refused_and_the_last_one_held(bad: float) -> None:
    robot = base()
    robot.take(np.full(3, 0.001), IDENTITY, np.zeros(6), POSE)
    assert not robot.take(np.array([bad, 0.0, 0.0]), IDENTITY, np.zeros(6), POSE)
    assert not robot.take(np.zeros(3), np.zeros(4), np.zeros(6), POSE)
    assert robot.position == pytest.approx(np.full(3, 0.001))
    assert robot.refused == 2


def test_a_command_that_answers_an_older_cycle_than_the_last_one_is_not_used() -> None:
    arm = active()
    newer, older = command(arm, torque=1.0), command(arm, behind=1, torque=9.0)
    arm.begin([newer, older], STILL)
    assert (arm.torque == 1.0).all()


@pytest.mark.parametrize("cycles", [64, 256])
def test_a_narrow_cycle_number_runs_over_again_and_again(cycles: int) -> None:
    arm = ArmLogic(N, cycle=1e-3, watchdog=4, silence=500, ramp=RampDown(time=0.25, damping=5.0), cycles=cycles)
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
