"""State machine of the drives: properties for any sequence of controlwords.

canopen's tables are the independent reference implementation of the standard.
"""

from __future__ import annotations

import pytest
from canopen.profiles.p402 import State402
from hypothesis import given, settings
from hypothesis import strategies as st

from freeflyer_adapters.cia402.state_machine import (
    POWERED,
    STATUSWORD,
    TOWARDS_ENABLED,
    TRANSITIONS,
    Command,
    DriveState,
    command_of,
    following,
    state_of,
    statusword_of,
)
from freeflyer_adapters.device.ramp_down import RampDown
from freeflyer_adapters.facility.drive_logic import STOPPING, DriveLogic

controlwords = st.one_of(
    st.integers(0, 0xFFFF), st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x80, 0x8F])
)
steps = st.lists(
    st.one_of(
        st.tuples(st.just("sync"), controlwords, st.floats(-500, 500)),
        st.tuples(st.just("sync without target"), st.just(0), st.just(0.0)),
        st.tuples(st.just("ticks"), st.integers(1, 40), st.floats(-2, 2)),
        st.tuples(st.just("fault"), st.sampled_from([0x2310, 0x4310]), st.just(0.0)),
    ),
    max_size=80,
)


def logic() -> DriveLogic:
    made = DriveLogic(tick=1e-3, watchdog=4, ramp=RampDown(time=0.02, damping=5.0))
    made.sync_period = 4e-3
    return made


@settings(max_examples=300, deadline=None)
@given(steps)
def test_torque_follows_the_target_in_operation_enabled_only(
    sequence: list[tuple[str, int, float]],
) -> None:
    # Start in Operation enabled, which random controlwords would rarely reach.
    drive = logic()
    for controlword in (0x06, 0x07, 0x0F):
        drive.synchronise(controlword, 0.0)
    for kind, number, value in sequence:
        before = (drive.state, drive.torque)
        if kind == "sync":
            drive.synchronise(number, value)
        elif kind == "sync without target":
            drive.synchronise(None, 123.0)
        elif kind == "fault":
            drive.fail(number)
        else:
            for _ in range(number):
                drive.advance(value)
        if drive.state in (DriveState.quick_stop_active, DriveState.fault_reaction_active):
            assert not drive.braked
            if kind == "sync" and before[0] in (*STOPPING, DriveState.operation_enabled):
                assert drive.torque == before[1]  # a drive that stops by itself ignores targets
        elif drive.state is DriveState.operation_enabled:
            assert not drive.braked
            if kind == "sync":
                assert drive.torque == value
        else:
            assert drive.torque == 0.0
            assert drive.braked


@given(st.floats(-2, 2), st.floats(-300, 300))
def test_a_drive_without_syncs_brakes_by_itself_within_its_ramp(
    velocity: float, torque: float
) -> None:
    drive = logic()
    for controlword in (0x06, 0x07, 0x0F, 0x0F):
        drive.synchronise(controlword, torque)
    assert drive.state is DriveState.operation_enabled
    for _ in range(16):
        drive.advance(velocity)
    assert drive.state is DriveState.operation_enabled  # four periods of 4 ms
    for _ in range(1 + 41):
        drive.advance(velocity)
    assert drive.state is DriveState.fault
    assert drive.braked
    assert drive.error == 0x8700


def test_every_statusword_decodes_to_at_most_one_state_as_in_canopen() -> None:
    names = {state: state.value.upper() for state in DriveState}
    for statusword in range(0x10000):
        own = state_of(statusword)
        reference = [
            name for name, (mask, value) in State402.SW_MASK.items() if statusword & mask == value
        ]
        assert ([names[own]] if own else []) == reference, hex(statusword)
        assert len(reference) <= 1


@pytest.mark.parametrize("state", DriveState)
def test_every_statusword_of_a_state_decodes_to_that_state(state: DriveState) -> None:
    assert state_of(statusword_of(state)) is state
    assert state_of(statusword_of(state, limit_active=True)) is state


def test_the_commanded_transitions_are_those_of_canopens_table() -> None:
    reference = set(State402.TRANSITIONTABLE)
    own = {(a.value.upper(), b.value.upper()) for (a, _), (_, b) in TRANSITIONS.items()}
    assert own <= reference
    automatic = {
        (a, b)
        for a, b in reference
        if State402.TRANSITIONTABLE[a, b] == 0 and b in ("NOT READY TO SWITCH ON", "FAULT")
    }
    automatic.add(("NOT READY TO SWITCH ON", "SWITCH ON DISABLED"))
    optional_or_reset = {
        ("QUICK STOP ACTIVE", "OPERATION ENABLED"),
        ("FAULT", "SWITCH ON DISABLED"),
    }
    assert reference - own == automatic | optional_or_reset
    for (a, b), controlword in State402.TRANSITIONTABLE.items():
        if (a, b) in own:
            state = next(s for s in DriveState if s.value.upper() == a)
            assert following(state, controlword, 0).value.upper() == b


@pytest.mark.parametrize("state", [s for s in DriveState if s in TOWARDS_ENABLED])
def test_the_commands_towards_operation_enabled_reach_it(state: DriveState) -> None:
    for _ in range(5):
        state = following(state, TOWARDS_ENABLED[state].value, 0)
    assert state is DriveState.operation_enabled


@given(controlwords, controlwords)
def test_only_a_rising_edge_resets_a_fault(before: int, controlword: int) -> None:
    after = following(DriveState.fault, controlword, before)
    assert (after is DriveState.switch_on_disabled) == (
        bool(controlword & 0x80) and not before & 0x80
    )


@given(controlwords)
def test_other_bits_of_the_controlword_change_no_command(controlword: int) -> None:
    assert command_of(controlword) is command_of(controlword & 0x0F)
    assert (
        command_of(Command.disable_voltage.value | (controlword & 0x0D)) is Command.disable_voltage
    )


def test_the_powered_states_have_the_masks_of_the_standard() -> None:
    assert {s for s in DriveState if s in POWERED} == {
        DriveState.operation_enabled, DriveState.quick_stop_active, DriveState.fault_reaction_active,
    }  # fmt: skip
    assert STATUSWORD[DriveState.operation_enabled] == (0x6F, 0x27)
