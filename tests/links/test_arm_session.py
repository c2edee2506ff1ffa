"""The host's end of an arm's life cycle: which mode a command may have, in every phase of a session. No clock, no wire."""

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
BEGIN = 1_000_000_000
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
    made.report(LifeCycle.inactive, made.number, BEGIN)
    return made


def activating(**of: bool) -> ArmSession:
    made = claimed(**of)
    made.activate(BEGIN)
    return made


def commanding() -> ArmSession:
    made = activating()
    made.answer(BEGIN)
    made.report(LifeCycle.active, made.number, BEGIN)
    return made


# Before the activation


@pytest.mark.parametrize("state", list(LifeCycle))
def test_who_only_listens_asks_for_nothing(state: LifeCycle) -> None:
    made = session()
    made.report(state, 0, BEGIN)
    assert made.answer(BEGIN) is Mode.idle


@pytest.mark.parametrize("state", [LifeCycle.inactive, LifeCycle.safe_stop, LifeCycle.fault])
def test_a_number_is_claimed_until_the_arm_echoes_it_and_is_inactive(state: LifeCycle) -> None:
    made = session()
    made.claim()
    made.report(state, 0, BEGIN)
    assert made.answer(BEGIN) is Mode.reset
    assert not made.is_claimed
    made.report(state, made.number, BEGIN)
    assert made.is_claimed is (state is LifeCycle.inactive)
    assert made.answer(BEGIN) is (Mode.idle if state is LifeCycle.inactive else Mode.reset)
    made.report(LifeCycle.inactive, made.number, BEGIN)
    assert made.is_claimed
    assert made.answer(BEGIN) is Mode.idle


def test_a_claim_without_an_echo_is_tried_with_another_number() -> None:
    """The arm may have used this one up."""
    made = session()
    made.claim()
    made.report(LifeCycle.inactive, 0, BEGIN)
    for _ in range(CLAIMS - 1):
        made.answer(BEGIN)
    assert made.number == FIRST
    made.answer(BEGIN)
    assert made.number == FIRST + 1


def test_the_number_stays_while_the_arm_obeys_another() -> None:
    made = session()
    made.claim()
    made.report(LifeCycle.inactive, OTHER, BEGIN)
    for _ in range(3 * CLAIMS):
        made.answer(BEGIN)
    assert made.number == FIRST
    assert made.is_obeyed_elsewhere
    assert not made.is_claimed


def test_after_a_reason_to_stop_nothing_is_claimed() -> None:
    made = session()
    made.claim()
    made.permit.lose("the user stopped")
    assert made.answer(BEGIN) is Mode.idle
    assert made.answer(BEGIN, brake=True) is Mode.brake


@pytest.mark.parametrize("is_claiming", [False, True])
def test_brakes_are_commanded_in_any_phase_before_the_activation(is_claiming: bool) -> None:
    made = session()
    if is_claiming:
        made.claim()
    assert made.answer(BEGIN, brake=True) is Mode.brake


# The activation


def test_only_the_activation_takes_the_permit() -> None:
    made = claimed()
    assert not made.permit.is_held
    assert not made.permits(Mode.torque, BEGIN)
    assert not made.permits(Mode.activate, BEGIN)
    made.activate(BEGIN)
    assert made.permit.is_held


def test_an_arm_is_asked_to_activate_until_it_is_active_and_only_then_commanded() -> None:
    made = activating()
    for _ in range(3):
        assert made.answer(BEGIN) is Mode.activate
        made.report(LifeCycle.inactive, made.number, BEGIN)
    made.report(LifeCycle.active, made.number, BEGIN)
    assert made.phase is Phase.commanding
    assert made.answer(BEGIN) is Mode.torque


def test_an_arm_that_is_active_for_another_is_not_commanded() -> None:
    made = activating()
    made.answer(BEGIN)
    made.report(LifeCycle.active, OTHER, BEGIN)
    assert made.phase is Phase.activating
    assert made.answer(BEGIN) is not Mode.torque


def test_a_claim_that_the_arm_has_forgotten_is_claimed_again_before_it_is_asked() -> None:
    made = activating()
    made.report(LifeCycle.inactive, 0, BEGIN)
    assert made.answer(BEGIN) is Mode.reset
    made.report(LifeCycle.inactive, made.number, BEGIN)
    assert made.answer(BEGIN) is Mode.activate


def test_once_it_was_asked_to_activate_nothing_is_claimed_or_reset() -> None:
    made = activating()
    made.answer(BEGIN)
    made.report(LifeCycle.inactive, 0, BEGIN)
    assert made.answer(BEGIN) is Mode.activate


@pytest.mark.parametrize("state", [LifeCycle.safe_stop, LifeCycle.fault, LifeCycle.unconfigured])
def test_an_arm_that_stops_while_it_is_activated_ends_the_activation(state: LifeCycle) -> None:
    made = activating()
    made.answer(BEGIN)
    made.report(state, made.number, BEGIN)
    assert made.permit.lost == f"arm went to {state.name} while it was activated"
    assert made.answer(BEGIN) is Mode.brake


@pytest.mark.parametrize("state", [LifeCycle.safe_stop, LifeCycle.fault])
def test_a_stop_that_comes_after_the_claim_ends_the_activation_and_is_not_reset(
    state: LifeCycle,
) -> None:
    """What was there before is reset by the claim; this is new."""
    made = activating()
    made.report(state, made.number, BEGIN)
    assert made.permit.lost == f"arm went to {state.name} before it was activated"
    made.report(LifeCycle.inactive, made.number, BEGIN)
    assert made.answer(BEGIN) is Mode.brake


def test_a_reason_to_stop_during_the_activation_brakes() -> None:
    made = activating()
    made.answer(BEGIN)
    made.permit.lose("the user stopped")
    assert made.answer(BEGIN) is Mode.brake
    made.report(
        LifeCycle.active, made.number, BEGIN
    )  # the last frame may have activated it all the same
    assert made.answer(BEGIN, brake=True) is Mode.brake


def test_a_hold_up_during_the_activation_brakes() -> None:
    made = activating()
    made.answer(BEGIN)
    assert made.answer(BEGIN + WATCHDOG + 1) is Mode.brake


# The end


def test_after_a_reason_to_stop_torque_goes_out_with_a_fresh_report_of_active_only() -> None:
    made = commanding()
    made.permit.lose("a limit was met")
    assert made.answer(BEGIN + WATCHDOG) is Mode.torque
    assert made.answer(BEGIN + WATCHDOG + 1) is Mode.idle
    made.report(LifeCycle.active, made.number, BEGIN + WATCHDOG + 1)
    assert made.answer(BEGIN + WATCHDOG + 1) is Mode.torque
    made.report(LifeCycle.safe_stop, made.number, BEGIN + WATCHDOG + 1)
    assert made.answer(BEGIN + WATCHDOG + 1) is Mode.idle
    assert made.answer(BEGIN + WATCHDOG + 1, brake=True) is Mode.brake


def test_a_held_up_loop_sends_no_torque_although_the_last_report_was_active() -> None:
    made = commanding()
    assert made.answer(BEGIN + WATCHDOG) is Mode.torque
    assert made.answer(BEGIN + WATCHDOG + 1) is Mode.idle
    assert made.permit.was_held_up


@pytest.mark.parametrize("obeyed", [0, OTHER])
def test_active_for_another_number_is_no_report_of_active(obeyed: int) -> None:
    """An arm that names no controller may be this one's; one that names another is not."""
    made = commanding()
    made.report(LifeCycle.active, obeyed, BEGIN)
    assert (made.permit.lost is None) is (obeyed == 0)


def test_an_arm_that_leaves_active_is_not_commanded_again() -> None:
    made = commanding()
    made.report(LifeCycle.safe_stop, made.number, BEGIN)
    made.report(LifeCycle.active, made.number, BEGIN)
    assert not made.permit.allows(BEGIN)


def test_the_last_look_before_a_frame_goes_out_sees_a_hold_up() -> None:
    made = commanding()
    late = BEGIN + WATCHDOG + 1
    assert made.permits(Mode.torque, BEGIN)
    assert not made.permits(Mode.torque, late)
    for mode in (Mode.idle, Mode.brake, Mode.reset):
        assert made.permits(mode, late)
    waiting = activating()
    assert waiting.permits(Mode.activate, BEGIN)
    assert not waiting.permits(Mode.activate, late)


# How old a report is


def test_a_report_is_as_old_as_the_answer_that_it_echoes_however_late_it_came() -> None:
    made = commanding()
    made.wrote(40, BEGIN)
    made.permit.lose("a limit was met")
    late = BEGIN + 20 * CYCLE
    made.report(LifeCycle.active, made.number, late, 40)
    assert made.answer(late) is Mode.idle
    made.wrote(41, late)
    made.report(LifeCycle.active, made.number, 0, 41)
    assert made.answer(late) is Mode.torque


def test_a_report_that_echoes_no_answer_of_this_session_counts_as_old() -> None:
    made = commanding()
    made.permit.lose("a limit was met")
    made.report(LifeCycle.active, made.number, BEGIN, 99)
    assert made.answer(BEGIN) is Mode.idle


def test_answers_of_the_last_cycles_are_remembered_and_older_ones_are_not() -> None:
    made = commanding()
    for k in range(REMEMBERED + 1):
        made.wrote(k, BEGIN)
    made.permit.lose("a limit was met")
    made.report(LifeCycle.active, made.number, BEGIN, 0)
    assert made.answer(BEGIN) is Mode.idle
    made.report(LifeCycle.active, made.number, BEGIN, 1)
    assert made.answer(BEGIN) is Mode.torque


# An arm without the mode `activate`, or one that says little


def test_an_implicit_arm_is_not_claimed_and_is_activated_by_torque() -> None:
    made = session(implicit=True)
    made.claim()
    made.report(LifeCycle.inactive, 0, BEGIN)
    assert made.answer(BEGIN) is Mode.idle
    made.report(LifeCycle.inactive, made.number, BEGIN)
    assert made.is_claimed
    made.activate(BEGIN)
    assert made.answer(BEGIN) is Mode.torque


@pytest.mark.parametrize("state", [LifeCycle.safe_stop, LifeCycle.fault])
def test_an_implicit_arm_that_has_stopped_is_reset_first_and_never_once_it_had_torque(
    state: LifeCycle,
) -> None:
    made = session(implicit=True)
    made.claim()
    made.report(state, made.number, BEGIN)
    assert made.is_claimed
    assert made.answer(BEGIN) is Mode.idle
    made.activate(BEGIN)
    assert made.answer(BEGIN) is Mode.reset
    made.report(LifeCycle.inactive, made.number, BEGIN)
    assert made.answer(BEGIN) is Mode.torque
    made.report(state, made.number, BEGIN)
    assert made.answer(BEGIN) is Mode.brake
    assert made.permit.lost == f"arm went to {state.name} while it was activated"


def test_an_arm_that_names_no_controller_is_claimed_by_its_state() -> None:
    made = session(echoes=False)
    made.claim()
    made.report(LifeCycle.inactive, 0, BEGIN)
    assert made.is_claimed


def test_an_arm_that_reports_neither_state_nor_echo_is_commanded_at_once_and_active_while_its_frames_come() -> (
    None
):
    made = session(implicit=True, reports_state=False)
    made.claim()
    made.report(None, made.number, BEGIN)
    assert made.answer(BEGIN) is Mode.idle
    made.activate(BEGIN)
    assert made.phase is Phase.commanding
    assert made.answer(BEGIN) is Mode.torque


def test_an_arm_that_reports_no_state_is_active_while_it_uses_this_sessions_answers() -> None:
    made = session(implicit=True, reports_state=False)
    made.claim()
    made.report(None, made.number, BEGIN, 39)  # an answer of another session
    made.activate(BEGIN)
    assert made.phase is Phase.activating
    assert made.answer(BEGIN) is Mode.torque
    made.wrote(40, BEGIN)
    made.report(None, made.number, BEGIN + CYCLE, 40)
    assert made.phase is Phase.commanding
    for k in range(1, 10):
        now = BEGIN + k * CYCLE
        # It is noticed with the state frame that shows it.
        assert made.answer(now) is (Mode.torque if (k - 1) * CYCLE <= WATCHDOG else Mode.idle)
        made.wrote(40 + k, now)
        made.report(None, made.number, now, 40)  # it goes on echoing the first one
        assert made.permit.may_ramp_down(now) is (k * CYCLE <= WATCHDOG)


@pytest.mark.parametrize("state", list(LifeCycle))
def test_a_report_of_another_state_takes_the_permit(state: LifeCycle) -> None:
    made = commanding()
    made.report(state, made.number, BEGIN)
    assert made.permit.allows(BEGIN) is (state is LifeCycle.active)


# Whatever happens


steps = st.tuples(
    st.sampled_from([0, CYCLE, WATCHDOG, WATCHDOG + 1]),
    st.none() | st.tuples(st.sampled_from(list(LifeCycle)), st.sampled_from([0, FIRST, OTHER])),
    st.booleans(),
)


@given(st.lists(steps, max_size=40), st.integers(0, 40), st.booleans())
def test_after_the_first_reason_to_stop_no_frame_activates_claims_or_gives_torque_without_a_fresh_report(
    happened: list[tuple[int, tuple[LifeCycle, int] | None, bool]], stop_at: int, implicit: bool
) -> None:
    made, now, active_at = activating(implicit=implicit), BEGIN, -WATCHDOG
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
