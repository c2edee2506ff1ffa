"""Rules of the permit: when commands with power, or torques of a graded stop, are allowed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer_adapters.device.permit import Permit

WATCHDOG = 4_000_000
START = 1_000_000_000


def permit(*, reports_state: bool = True) -> Permit:
    return Permit("arm", watchdog=WATCHDOG, reports_state=reports_state)


def taken(*, reports_state: bool = True) -> Permit:
    made = permit(reports_state=reports_state)
    made.take(START)
    return made


def test_without_an_activation_nothing_is_allowed() -> None:
    made = permit()
    made.report(True, START)
    assert not made.is_held
    assert not made.allows(START)
    assert not made.may_ramp_down(START)


def test_an_activation_takes_the_permit_once() -> None:
    made = taken()
    assert made.is_held
    assert made.allows(START)
    with pytest.raises(RuntimeError, match="arm: this permit was taken or lost before"):
        made.take(START)


def test_a_lost_permit_cannot_be_taken() -> None:
    made = permit()
    made.lose("the user stopped")
    with pytest.raises(RuntimeError, match="this permit was taken or lost before"):
        made.take(START)
    assert not made.allows(START)


def test_the_first_reason_stays_and_a_lost_permit_is_never_restored() -> None:
    made = taken()
    made.lose("a limit was met")
    made.lose("the user stopped")
    made.report(True, START)
    made.wrote(START)
    assert made.lost == "a limit was met"
    assert not made.allows(START)


def test_a_gap_up_to_the_watchdog_is_allowed() -> None:
    made = taken()
    assert made.allows(START + WATCHDOG)
    assert not made.was_held_up
    assert not made.allows(START + WATCHDOG + 1)
    assert made.was_held_up
    assert made.lost == (
        "the loop was held up for 0.004 s, longer than the watchdog of arm (0.004 s); the device has stopped"
    )


def test_the_gap_starts_at_the_last_sent_frame() -> None:
    made = taken()
    for k in range(1, 10):
        made.wrote(START + k * WATCHDOG)
        assert made.allows(START + k * WATCHDOG)
    assert made.allows(START + 10 * WATCHDOG)
    assert not made.allows(START + 10 * WATCHDOG + 1)


def test_a_frame_after_too_long_a_gap_does_not_hide_the_gap() -> None:
    made = taken()
    late = START + 2 * WATCHDOG
    made.wrote(late)
    assert made.was_held_up
    assert not made.allows(late)


def test_frames_before_the_activation_start_no_gap() -> None:
    made = permit()
    made.wrote(0)
    made.wrote(START)
    made.take(START)
    assert made.allows(START)
    assert not made.was_held_up


def test_a_delay_of_the_loop_after_another_reason_is_detected() -> None:
    """The graded stop must not send set points to a base robot that has stopped by itself."""
    made = taken(reports_state=False)
    made.lose("a limit was met")
    assert not made.was_held_up
    made.allows(START + 2 * WATCHDOG)
    assert made.was_held_up
    assert made.lost == "a limit was met"


def test_a_report_of_inactive_before_active_keeps_the_permit() -> None:
    made = taken()
    made.report(False, START)
    assert made.allows(START)


def test_a_report_of_another_state_after_active_ends_the_permit() -> None:
    made = taken()
    made.report(True, START)
    assert made.allows(START)
    made.report(False, START)
    assert not made.allows(START)
    assert made.lost == "arm reported another state than active"


@pytest.mark.parametrize("reports_state", [False, True])
def test_before_the_first_report_of_active_no_report_is_required(
    reports_state: bool,
) -> None:
    made = taken(reports_state=reports_state)
    for k in range(1, 10):
        made.wrote(START + k * WATCHDOG)
    assert made.allows(START + 9 * WATCHDOG)


def test_a_device_that_reports_its_state_is_active_until_it_reports_another_state() -> None:
    """The quality monitor, not the permit, detects missing reports."""
    made = taken()
    made.report(True, START)
    for k in range(1, 10):
        made.wrote(START + k * WATCHDOG)
    assert made.allows(START + 9 * WATCHDOG)


# The graded stop


def test_a_graded_stop_may_use_torque_within_the_watchdog_of_a_report_of_active() -> None:
    made = taken()
    made.report(True, START)
    made.lose("a limit was met")
    assert made.may_ramp_down(START + WATCHDOG)
    assert not made.may_ramp_down(START + WATCHDOG + 1)


def test_a_report_of_another_state_ends_the_torque_of_a_graded_stop() -> None:
    made = taken()
    made.report(True, START)
    made.lose("a limit was met")
    made.report(False, START)
    assert not made.may_ramp_down(START)


def test_a_graded_stop_of_a_device_that_never_was_active_has_no_torque() -> None:
    made = taken()
    made.lose("the user stopped")
    assert not made.may_ramp_down(START)


def test_after_a_delay_of_the_loop_a_recent_report_allows_the_ramp_down() -> None:
    made = taken()
    later = START + 10 * WATCHDOG
    assert not made.allows(later)
    assert not made.may_ramp_down(later)
    made.report(True, later)
    assert made.may_ramp_down(later)


def test_after_a_delay_of_the_loop_a_device_without_state_reports_is_not_ramped_down() -> None:
    made = taken(reports_state=False)
    later = START + 10 * WATCHDOG
    made.report(True, later)
    assert not made.may_ramp_down(later)


def test_without_a_delay_of_the_loop_a_device_without_state_reports_is_ramped_down() -> None:
    made = taken(reports_state=False)
    made.report(True, START)
    made.lose("a limit was met")
    assert made.may_ramp_down(START)


steps = st.tuples(
    st.sampled_from(["write", "active", "inactive", "lose", "check"]),
    st.sampled_from([0, 1, WATCHDOG // 2, WATCHDOG, WATCHDOG + 1]),
)


@given(st.lists(steps, max_size=60))
def test_power_is_allowed_until_the_first_gap_or_reason_and_never_again(
    happened: list[tuple[str, int]],
) -> None:
    made, now = taken(), START
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
