"""The permit, rule by rule: when a command that gives power may be sent, and when a graded stop may still use torque. No clock."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer_adapters.device.permit import Permit

WATCHDOG = 4_000_000
BEGIN = 1_000_000_000


def permit(*, reports_state: bool = True) -> Permit:
    return Permit("arm", watchdog=WATCHDOG, reports_state=reports_state)


def taken(*, reports_state: bool = True) -> Permit:
    made = permit(reports_state=reports_state)
    made.take(BEGIN)
    return made


def test_without_an_activation_nothing_is_allowed() -> None:
    made = permit()
    made.report(True, BEGIN)
    assert not made.is_held
    assert not made.allows(BEGIN)
    assert not made.may_ramp_down(BEGIN)


def test_an_activation_takes_it_once() -> None:
    made = taken()
    assert made.is_held
    assert made.allows(BEGIN)
    with pytest.raises(RuntimeError, match="arm: a permit is taken once"):
        made.take(BEGIN)


def test_one_that_was_lost_before_is_not_taken() -> None:
    made = permit()
    made.lose("the user stopped")
    with pytest.raises(RuntimeError, match="a permit is taken once"):
        made.take(BEGIN)
    assert not made.allows(BEGIN)


def test_the_first_reason_stays_and_nothing_gives_it_back() -> None:
    made = taken()
    made.lose("a limit was met")
    made.lose("the user stopped")
    made.report(True, BEGIN)
    made.wrote(BEGIN)
    assert made.lost == "a limit was met"
    assert not made.allows(BEGIN)


def test_a_gap_of_just_the_watchdog_is_allowed_and_the_next_nanosecond_is_not() -> None:
    made = taken()
    assert made.allows(BEGIN + WATCHDOG)
    assert not made.was_held_up
    assert not made.allows(BEGIN + WATCHDOG + 1)
    assert made.was_held_up
    assert made.lost == (
        "the loop was held up for 0.004 s, longer than the watchdog of arm (0.004 s), which has stopped by then"
    )


def test_the_gap_counts_from_the_last_own_frame() -> None:
    made = taken()
    for k in range(1, 10):
        made.wrote(BEGIN + k * WATCHDOG)
        assert made.allows(BEGIN + k * WATCHDOG)
    assert made.allows(BEGIN + 10 * WATCHDOG)
    assert not made.allows(BEGIN + 10 * WATCHDOG + 1)


def test_a_frame_that_goes_out_after_too_long_a_gap_does_not_hide_it() -> None:
    made = taken()
    late = BEGIN + 2 * WATCHDOG
    made.wrote(late)
    assert made.was_held_up
    assert not made.allows(late)


def test_frames_before_the_activation_begin_no_gap() -> None:
    made = permit()
    made.wrote(0)
    made.wrote(BEGIN)
    made.take(BEGIN)
    assert made.allows(BEGIN)
    assert not made.was_held_up


def test_a_hold_up_after_another_reason_is_noticed_too() -> None:
    """A base robot that has stopped by itself must not be sent a set point by the graded stop."""
    made = taken(reports_state=False)
    made.lose("a limit was met")
    assert not made.was_held_up
    made.allows(BEGIN + 2 * WATCHDOG)
    assert made.was_held_up
    assert made.lost == "a limit was met"


def test_a_device_that_is_not_active_yet_loses_nothing() -> None:
    made = taken()
    made.report(False, BEGIN)
    assert made.allows(BEGIN)


def test_a_device_that_reports_another_state_after_active_loses_it() -> None:
    made = taken()
    made.report(True, BEGIN)
    assert made.allows(BEGIN)
    made.report(False, BEGIN)
    assert not made.allows(BEGIN)
    assert made.lost == "arm reported another state than active"


@pytest.mark.parametrize("reports_state", [False, True])
def test_before_anything_has_shown_that_a_device_is_active_nothing_is_missed(
    reports_state: bool,
) -> None:
    made = taken(reports_state=reports_state)
    for k in range(1, 10):
        made.wrote(BEGIN + k * WATCHDOG)
    assert made.allows(BEGIN + 9 * WATCHDOG)


def test_a_device_that_reports_its_state_is_active_until_it_reports_another() -> None:
    """Silence is the quality monitor's, which counts lost cycles."""
    made = taken()
    made.report(True, BEGIN)
    for k in range(1, 10):
        made.wrote(BEGIN + k * WATCHDOG)
    assert made.allows(BEGIN + 9 * WATCHDOG)


# The graded stop


def test_a_graded_stop_may_use_torque_while_a_report_of_active_is_younger_than_the_watchdog() -> (
    None
):
    made = taken()
    made.report(True, BEGIN)
    made.lose("a limit was met")
    assert made.may_ramp_down(BEGIN + WATCHDOG)
    assert not made.may_ramp_down(BEGIN + WATCHDOG + 1)


def test_a_report_of_another_state_ends_the_torque_of_a_graded_stop() -> None:
    made = taken()
    made.report(True, BEGIN)
    made.lose("a limit was met")
    made.report(False, BEGIN)
    assert not made.may_ramp_down(BEGIN)


def test_a_graded_stop_of_a_device_that_never_was_active_has_no_torque() -> None:
    made = taken()
    made.lose("the user stopped")
    assert not made.may_ramp_down(BEGIN)


def test_after_a_hold_up_a_device_that_reports_its_state_is_brought_down_with_a_fresh_report() -> (
    None
):
    made = taken()
    later = BEGIN + 10 * WATCHDOG
    assert not made.allows(later)
    assert not made.may_ramp_down(later)
    made.report(True, later)
    assert made.may_ramp_down(later)


def test_after_a_hold_up_a_device_that_reports_no_state_gets_nothing() -> None:
    made = taken(reports_state=False)
    later = BEGIN + 10 * WATCHDOG
    made.report(True, later)
    assert not made.may_ramp_down(later)


def test_without_a_hold_up_a_device_that_reports_no_state_is_brought_down() -> None:
    made = taken(reports_state=False)
    made.report(True, BEGIN)
    made.lose("a limit was met")
    assert made.may_ramp_down(BEGIN)


steps = st.tuples(
    st.sampled_from(["write", "active", "inactive", "lose", "look"]),
    st.sampled_from([0, 1, WATCHDOG // 2, WATCHDOG, WATCHDOG + 1]),
)


@given(st.lists(steps, max_size=60))
def test_whatever_happens_power_is_allowed_only_without_a_gap_and_never_again(
    happened: list[tuple[str, int]],
) -> None:
    made, now = taken(), BEGIN
    wrote, was_active, has_ended = now, False, False
    for what, later in happened:
        now += later
        has_ended = has_ended or now - wrote > WATCHDOG
        if what == "write":
            made.wrote(now)
            wrote = now
        elif what == "lose":
            made.lose("a reason")
            has_ended = True
        elif what in ("active", "inactive"):
            made.report(what == "active", now)
            has_ended = has_ended or (was_active and what == "inactive")
            was_active = was_active or what == "active"
        assert made.allows(now) is not has_ended
