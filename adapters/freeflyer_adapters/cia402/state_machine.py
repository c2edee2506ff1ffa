"""State machine of a power drive system as tables.

The standards CiA 402-2 and IEC 61800-7-201 define this state machine, and call it FSA (finite state
automaton). The tables define the statusword, the controlword and the transitions. The host and the
virtual drive use the same tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum


class DriveState(Enum):
    """State of a drive. The value is the name of the state in the standard and in messages."""

    not_ready_to_switch_on = "Not ready to switch on"
    switch_on_disabled = "Switch on disabled"
    ready_to_switch_on = "Ready to switch on"
    switched_on = "Switched on"
    operation_enabled = "Operation enabled"
    quick_stop_active = "Quick stop active"
    fault_reaction_active = "Fault reaction active"
    fault = "Fault"


S = DriveState

STATUSWORD: Mapping[DriveState, tuple[int, int]] = {
    S.not_ready_to_switch_on: (0x4F, 0x00),
    S.switch_on_disabled: (0x4F, 0x40),
    S.ready_to_switch_on: (0x6F, 0x21),
    S.switched_on: (0x6F, 0x23),
    S.operation_enabled: (0x6F, 0x27),
    S.quick_stop_active: (0x6F, 0x07),
    S.fault_reaction_active: (0x4F, 0x0F),
    S.fault: (0x4F, 0x08),
}
"""State -> mask and value of the statusword (6041h). Bit 5 is 0 in the state Quick stop active."""

VOLTAGE_ENABLED, REMOTE, LIMIT_ACTIVE, FOLLOWS_COMMAND = 1 << 4, 1 << 9, 1 << 11, 1 << 12
"""Further bits of the statusword.

In the mode CST (cyclic synchronous torque), bit 12 means that the drive follows the target torque.
"""

POWERED = frozenset({S.operation_enabled, S.quick_stop_active, S.fault_reaction_active})
"""States with torque. In all other states the torque is zero and the brake is engaged."""


def state_of(statusword: int) -> DriveState | None:
    """Return the state in a statusword, or None if the bits are not a defined state."""
    for state, (mask, value) in STATUSWORD.items():
        if statusword & mask == value:
            return state
    return None


def statusword_of(state: DriveState, *, limit_active: bool = False) -> int:
    """Return the statusword of a drive in the mode CST with the supply voltage on."""
    bits = STATUSWORD[state][1] | VOLTAGE_ENABLED | REMOTE
    bits |= LIMIT_ACTIVE if limit_active else 0
    return bits | (FOLLOWS_COMMAND if state is S.operation_enabled else 0)


class Command(Enum):
    """Command in bits 0 to 3 of the controlword (6040h).

    The value is the controlword that the host sends for the command. Bit 7 belongs to no command: a
    rising edge of bit 7 resets a fault (FAULT_RESET).
    """

    disable_voltage = 0x00
    quick_stop = 0x02
    shutdown = 0x06
    switch_on = 0x07
    """In the state Operation enabled, the same bits mean "disable operation"."""
    enable_operation = 0x0F


C = Command
FAULT_RESET = 0x80


def command_of(controlword: int) -> Command:
    """Return the command in a controlword.

    Bit 0: switch on; bit 1: enable voltage; bit 2: quick stop (active low); bit 3: enable
    operation. The meaning of the other bits depends on the mode of the drive.
    """
    if not controlword & 0x02:
        return C.disable_voltage
    if not controlword & 0x04:
        return C.quick_stop
    if not controlword & 0x01:
        return C.shutdown
    return C.enable_operation if controlword & 0x08 else C.switch_on


TRANSITIONS: Mapping[tuple[DriveState, Command], tuple[int, DriveState]] = {
    (S.switch_on_disabled, C.shutdown): (2, S.ready_to_switch_on),
    (S.ready_to_switch_on, C.switch_on): (3, S.switched_on),
    # The command "enable operation" includes the bits of "switch on". Therefore the first
    # controlword causes transition 3. The next controlword causes transition 4.
    (S.ready_to_switch_on, C.enable_operation): (3, S.switched_on),
    (S.switched_on, C.enable_operation): (4, S.operation_enabled),
    (S.operation_enabled, C.switch_on): (5, S.switched_on),
    (S.switched_on, C.shutdown): (6, S.ready_to_switch_on),
    (S.ready_to_switch_on, C.quick_stop): (7, S.switch_on_disabled),
    (S.ready_to_switch_on, C.disable_voltage): (7, S.switch_on_disabled),
    (S.operation_enabled, C.shutdown): (8, S.ready_to_switch_on),
    (S.operation_enabled, C.disable_voltage): (9, S.switch_on_disabled),
    (S.switched_on, C.quick_stop): (10, S.switch_on_disabled),
    (S.switched_on, C.disable_voltage): (10, S.switch_on_disabled),
    (S.operation_enabled, C.quick_stop): (11, S.quick_stop_active),
    (S.quick_stop_active, C.disable_voltage): (12, S.switch_on_disabled),
}
"""State and command -> number of the transition in the standard, and next state.

The table contains only the transitions that a command causes. The drive itself causes transitions 0
and 1 at power on, 13 at a fault, and 14 after the fault reaction. Transition 12 has two causes: the
command `disable_voltage`, which is in the table, and the end of a quick stop.
Transition 15 is the fault reset (see `following`). Transition 16 enables the drive again after a
quick stop. Transition 16 is optional and is not used here."""

TOWARDS_ENABLED: Mapping[DriveState, Command] = {
    S.switch_on_disabled: C.shutdown,
    S.ready_to_switch_on: C.switch_on,
    S.switched_on: C.enable_operation,
    S.operation_enabled: C.enable_operation,
    S.quick_stop_active: C.disable_voltage,
}
"""State -> next command of the host on the way to the state Operation enabled.

In all other states, the host waits, or resets the fault by SDO before the activation."""


def following(state: DriveState, controlword: int, before: int) -> DriveState:
    """Return the next state after a controlword.

    If no transition is defined, the state does not change. `before`: previous controlword, which is
    needed to detect the rising edge of the fault reset.
    """
    if state is S.fault:
        rises = controlword & FAULT_RESET and not before & FAULT_RESET
        return S.switch_on_disabled if rises else state
    _, to = TRANSITIONS.get((state, command_of(controlword)), (0, state))
    return to
