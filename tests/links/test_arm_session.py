"""Modes of the command frames in every phase of an arm session, without a clock or a bus."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer_adapters.arm.frames import Mode
from freeflyer_adapters.arm.session import CLAIMS, REMEMBERED, ArmSession, Phase
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.device.permit import Permit

WATCHDOG = 4_000_000
CYCLE = 1_000_000
START = 1_000_000_000
FIRST = 101
OTHER = 7


def session(
    *, implicit: bool = False, echoes: bool = True, reports_state: bool = True
) -> ArmSession:
    numbers = itertools.count(FIRST)
    permit = Permit("arm", watchdog=WATCHDOG, reports_state=reports_state)
    return ArmSession(permit, lambda: next(numbers), implicit=implicit, echoes=echoes)


def claimed(**of: bool) -> ArmSession:
    made = session(**of)
    made.claim()
    made.report(LifeCycle.inactive, made.number, START)
    return made


def activating(**of: bool) -> ArmSession:
    made = claimed(**of)
    made.activate(START)
    return made


def commanding() -> ArmSession:
    made = activating()
    made.answer(START)
    made.report(LifeCycle.active, made.number, START)
    return made


# Before the activation


@pytest.mark.parametrize("state", list(LifeCycle))
def test_a_session_that_only_listens_sends_idle_frames(state: LifeCycle) -> None:
    made = session()
    made.report(state, 0, START)
    assert made.answer(START) is Mode.idle


@pytest.mark.parametrize("state", [LifeCycle.inactive, LifeCycle.safe_stop, LifeCycle.fault])
def test_a_number_is_claimed_until_the_arm_echoes_it_and_is_inactive(state: LifeCycle) -> None:
    made = session()
    made.claim()
    made.report(state, 0, START)
    assert made.answer(START) is Mode.reset
    assert not made.is_claimed
    made.report(state, made.number, START)
    assert made.is_claimed is (state is LifeCycle.inactive)
    assert made.answer(START) is (Mode.idle if state is LifeCycle.inactive else Mode.reset)
    made.report(LifeCycle.inactive, made.number, START)
    assert made.is_claimed
    assert made.answer(START) is Mode.idle


def test_a_claim_without_an_echo_is_tried_with_another_number() -> None:
    """The first number may have expired in the arm."""
    made = session()
    made.claim()
    made.report(LifeCycle.inactive, 0, START)
    for _ in range(CLAIMS - 1):
        made.answer(START)
    assert made.number == FIRST
    made.answer(START)
    assert made.number == FIRST + 1


def test_the_number_stays_while_the_arm_accepts_another_controller() -> None:
    made = session()
    made.claim()
    made.report(LifeCycle.inactive, OTHER, START)
    for _ in range(3 * CLAIMS):
        made.answer(START)
    assert made.number == FIRST
    assert made.has_other_controller
    assert not made.is_claimed


def test_after_a_reason_to_stop_nothing_is_claimed() -> None:
    made = session()
    made.claim()
    made.permit.lose("the user stopped")
    assert made.answer(START) is Mode.idle
    assert made.answer(START, brake=True) is Mode.brake


@pytest.mark.parametrize("is_claiming", [False, True])
def test_brakes_are_commanded_in_any_phase_before_the_activation(is_claiming: bool) -> None:
    made = session()
    if is_claiming:
        made.claim()
    assert made.answer(START, brake=True) is Mode.brake


# The activation


def test_only_the_activation_takes_the_permit() -> None:
    made = claimed()
    assert not made.permit.is_held
    assert not made.permits(Mode.torque, START)
    assert not made.permits(Mode.activate, START)
    made.activate(START)
    assert made.permit.is_held


def test_activation_is_requested_until_the_arm_is_active_and_then_torque_is_sent() -> None:
    made = activating()
    for _ in range(3):
        assert made.answer(START) is Mode.activate
        made.report(LifeCycle.inactive, made.number, START)
    made.report(LifeCycle.active, made.number, START)
    assert made.phase is Phase.commanding
    assert made.answer(START) is Mode.torque


def test_an_arm_that_is_active_for_another_session_gets_no_torque() -> None:
    made = activating()
    made.answer(START)
    made.report(LifeCycle.active, OTHER, START)
    assert made.phase is Phase.activating
    assert made.answer(START) is not Mode.torque


def test_a_claim_that_the_arm_has_dropped_is_repeated_before_the_activation() -> None:
    made = activating()
    made.report(LifeCycle.inactive, 0, START)
    assert made.answer(START) is Mode.reset
    made.report(LifeCycle.inactive, made.number, START)
    assert made.answer(START) is Mode.activate


def test_after_the_activation_request_nothing_is_claimed_or_reset() -> None:
    made = activating()
    made.answer(START)
    made.report(LifeCycle.inactive, 0, START)
    assert made.answer(START) is Mode.activate


@pytest.mark.parametrize("state", [LifeCycle.safe_stop, LifeCycle.fault, LifeCycle.unconfigured])
def test_an_arm_that_stops_while_it_is_activated_ends_the_activation(state: LifeCycle) -> None:
    made = activating()
    made.answer(START)
    made.report(state, made.number, START)
    assert made.permit.lost == f"arm went to {state.name} during its activation"
    assert made.answer(START) is Mode.brake


@pytest.mark.parametrize("state", [LifeCycle.safe_stop, LifeCycle.fault])
def test_a_stop_that_comes_after_the_claim_ends_the_activation_and_is_not_reset(
    state: LifeCycle,
) -> None:
    """The claim only resets a stop that came before the claim."""
    made = activating()
    made.report(state, made.number, START)
    assert made.permit.lost == f"arm went to {state.name} before its activation"
    made.report(LifeCycle.inactive, made.number, START)
    assert made.answer(START) is Mode.brake


def test_a_reason_to_stop_during_the_activation_brakes() -> None:
    made = activating()
    made.answer(START)
    made.permit.lose("the user stopped")
    assert made.answer(START) is Mode.brake
    made.report(LifeCycle.active, made.number, START)  # the last frame has activated the arm
    assert made.answer(START, brake=True) is Mode.brake


def test_a_delay_of_the_loop_during_the_activation_brakes() -> None:
    made = activating()
    made.answer(START)
    assert made.answer(START + WATCHDOG + 1) is Mode.brake


# During and after a stop


def test_after_a_reason_to_stop_torque_needs_a_recent_report_of_active() -> None:
    made = commanding()
    made.permit.lose("a limit was met")
    assert made.answer(START + WATCHDOG) is Mode.torque
    assert made.answer(START + WATCHDOG + 1) is Mode.idle
    made.report(LifeCycle.active, made.number, START + WATCHDOG + 1)
    assert made.answer(START + WATCHDOG + 1) is Mode.torque
    made.report(LifeCycle.safe_stop, made.number, START + WATCHDOG + 1)
    assert made.answer(START + WATCHDOG + 1) is Mode.idle
    assert made.answer(START + WATCHDOG + 1, brake=True) is Mode.brake


def test_a_delayed_loop_sends_no_torque_although_the_last_report_was_active() -> None:
    made = commanding()
    assert made.answer(START + WATCHDOG) is Mode.torque
    assert made.answer(START + WATCHDOG + 1) is Mode.idle
    assert made.permit.was_held_up


@pytest.mark.parametrize("echoed", [0, OTHER])
def test_active_for_another_session_does_not_count_as_active(echoed: int) -> None:
    """An arm that echoes no number may be active for this session."""
    made = commanding()
    made.report(LifeCycle.active, echoed, START)
    assert (made.permit.lost is None) is (echoed == 0)


def test_an_arm_that_leaves_active_is_not_commanded_again() -> None:
    made = commanding()
    made.report(LifeCycle.safe_stop, made.number, START)
    made.report(LifeCycle.active, made.number, START)
    assert not made.permit.allows(START)


def test_the_last_check_before_transmission_detects_a_delay_of_the_loop() -> None:
    made = commanding()
    late = START + WATCHDOG + 1
    assert made.permits(Mode.torque, START)
    assert not made.permits(Mode.torque, late)
    for mode in (Mode.idle, Mode.brake, Mode.reset):
        assert made.permits(mode, late)
    waiting = activating()
    assert waiting.permits(Mode.activate, START)
    assert not waiting.permits(Mode.activate, late)


# Age of a report


def test_a_report_is_as_old_as_the_answer_that_it_echoes() -> None:
    made = commanding()
    made.wrote(40, START)
    made.permit.lose("a limit was met")
    late = START + 20 * CYCLE
    made.report(LifeCycle.active, made.number, late, 40)
    assert made.answer(late) is Mode.idle
    made.wrote(41, late)
    made.report(LifeCycle.active, made.number, 0, 41)
    assert made.answer(late) is Mode.torque


def test_a_report_that_echoes_no_answer_of_this_session_counts_as_old() -> None:
    made = commanding()
    made.permit.lose("a limit was met")
    made.report(LifeCycle.active, made.number, START, 99)
    assert made.answer(START) is Mode.idle


def test_only_the_send_times_of_the_last_answers_are_stored() -> None:
    made = commanding()
    for k in range(REMEMBERED + 1):
        made.wrote(k, START)
    made.permit.lose("a limit was met")
    made.report(LifeCycle.active, made.number, START, 0)
    assert made.answer(START) is Mode.idle
    made.report(LifeCycle.active, made.number, START, 1)
    assert made.answer(START) is Mode.torque


# An arm without the mode `activate`, or with few signals


def test_an_implicit_arm_is_not_claimed_and_is_activated_by_torque() -> None:
    made = session(implicit=True)
    made.claim()
    made.report(LifeCycle.inactive, 0, START)
    assert made.answer(START) is Mode.idle
    made.report(LifeCycle.inactive, made.number, START)
    assert made.is_claimed
    made.activate(START)
    assert made.answer(START) is Mode.torque


@pytest.mark.parametrize("state", [LifeCycle.safe_stop, LifeCycle.fault])
def test_a_stopped_implicit_arm_is_reset_before_the_first_torque_only(
    state: LifeCycle,
) -> None:
    made = session(implicit=True)
    made.claim()
    made.report(state, made.number, START)
    assert made.is_claimed
    assert made.answer(START) is Mode.idle
    made.activate(START)
    assert made.answer(START) is Mode.reset
    made.report(LifeCycle.inactive, made.number, START)
    assert made.answer(START) is Mode.torque
    made.report(state, made.number, START)
    assert made.answer(START) is Mode.brake
    assert made.permit.lost == f"arm went to {state.name} during its activation"


def test_an_arm_without_echo_is_claimed_by_its_state() -> None:
    made = session(echoes=False)
    made.claim()
    made.report(LifeCycle.inactive, 0, START)
    assert made.is_claimed


def test_an_arm_without_state_and_echo_is_commanded_immediately_and_counts_as_active() -> None:
    made = session(implicit=True, reports_state=False)
    made.claim()
    made.report(None, made.number, START)
    assert made.answer(START) is Mode.idle
    made.activate(START)
    assert made.phase is Phase.commanding
    assert made.answer(START) is Mode.torque


def test_an_arm_without_state_is_active_while_it_echoes_answers_of_this_session() -> None:
    made = session(implicit=True, reports_state=False)
    made.claim()
    made.report(None, made.number, START, 39)  # an answer of another session
    made.activate(START)
    assert made.phase is Phase.activating
    assert made.answer(START) is Mode.torque
    made.wrote(40, START)
    made.report(None, made.number, START + CYCLE, 40)
    assert made.phase is Phase.commanding
    for k in range(1, 10):
        now = START + k * CYCLE
        # The session detects an old echo only when it receives the state frame with this echo.
        assert made.answer(now) is (Mode.torque if (k - 1) * CYCLE <= WATCHDOG else Mode.idle)
        made.wrote(40 + k, now)
        made.report(None, made.number, now, 40)  # the arm keeps echoing the first answer
        assert made.permit.may_ramp_down(now) is (k * CYCLE <= WATCHDOG)


@pytest.mark.parametrize("state", list(LifeCycle))
def test_a_report_of_another_state_ends_the_permit(state: LifeCycle) -> None:
    made = commanding()
    made.report(state, made.number, START)
    assert made.permit.allows(START) is (state is LifeCycle.active)


# Any sequence of events


steps = st.tuples(
    st.sampled_from([0, CYCLE, WATCHDOG, WATCHDOG + 1]),
    st.none() | st.tuples(st.sampled_from(list(LifeCycle)), st.sampled_from([0, FIRST, OTHER])),
    st.booleans(),
)


@given(st.lists(steps, max_size=40), st.integers(0, 40), st.booleans())
def test_after_the_first_reason_to_stop_frames_only_ramp_down_with_a_recent_report(
    happened: list[tuple[int, tuple[LifeCycle, int] | None, bool]], stop_at: int, implicit: bool
) -> None:
    made, now, active_at = activating(implicit=implicit), START, -WATCHDOG
    for k, (later, report, brake) in enumerate(happened):
        now += later
        if k == stop_at:
            made.permit.lose("a reason")
        if report is not None:
            made.report(*report, now)
            active_at = (
                now
                if report in ((LifeCycle.active, 0), (LifeCycle.active, made.number))
                else -WATCHDOG
            )
        mode = made.answer(now, brake=brake)
        if brake:
            assert mode is Mode.brake
        if made.permit.lost is None:
            made.wrote(k, now)
            continue
        assert mode in (Mode.torque, Mode.idle, Mode.brake)
        if mode is Mode.torque:
            assert now - active_at <= WATCHDOG
