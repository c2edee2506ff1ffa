"""The power drive system's state machine (IEC 61800-7-201, "FSA"; CiA 402-2) as tables: statusword, controlword, transitions.

Pure data and decisions: nothing is sent here, and both ends, the host and the virtual drive, use the same tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum


class DriveState(Enum):
    """Named as the standard names them; the value is how a sentence says it."""

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
"""Mask and value of the statusword (6041h); in the states with the wider mask, bit 5 (quick stop) is 0 while one is active."""

VOLTAGE_ENABLED, REMOTE, LIMIT_ACTIVE, FOLLOWS_COMMAND = 1 << 4, 1 << 9, 1 << 11, 1 << 12
"""Further bits of the statusword; bit 12 in mode CST: the drive follows the command value."""

POWERED = frozenset({S.operation_enabled, S.quick_stop_active, S.fault_reaction_active})
"""Where the drive function is on: in all other states there is no torque, and the brake holds."""


def state_of(statusword: int) -> DriveState | None:
    """None for a pattern that the standard does not have."""
    for state, (mask, value) in STATUSWORD.items():
        if statusword & mask == value:
            return state
    return None


def statusword_of(state: DriveState, *, limit_active: bool = False) -> int:
    """As a drive in mode CST with its supply on says it."""
    word = STATUSWORD[state][1] | VOLTAGE_ENABLED | REMOTE
    word |= LIMIT_ACTIVE if limit_active else 0
    return word | (FOLLOWS_COMMAND if state is S.operation_enabled else 0)


class Command(Enum):
    """What bits 0 to 3 of the controlword (6040h) mean; bit 7 resets a fault by its rising edge. The value is what the host sends."""

    disable_voltage = 0x00
    quick_stop = 0x02
    shutdown = 0x06
    switch_on = 0x07
    """From Operation enabled the same bits mean "disable operation"."""
    enable_operation = 0x0F


C = Command
FAULT_RESET = 0x80


def command_of(controlword: int) -> Command:
    """Bit 1 is enable voltage, bit 2 quick stop (active low), bit 0 switch on, bit 3 enable operation; the others are modes' own."""
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
    # Enable operation has the bits of switch on, too; the second step follows at the next controlword.
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
"""Number in the standard, and where it leads. Not commanded: 0 and 1 at power on, 12 at the end of a quick stop, 13 at a fault, 14
after its reaction; 15 is the fault reset. 16 (back from a quick stop) is optional there and not used here."""

TOWARDS_ENABLED: Mapping[DriveState, Command] = {
    S.switch_on_disabled: C.shutdown,
    S.ready_to_switch_on: C.switch_on,
    S.switched_on: C.enable_operation,
    S.operation_enabled: C.enable_operation,
    S.quick_stop_active: C.disable_voltage,
}
"""What the host commands next on the way to Operation enabled; in the states that are not here it waits, or resets the fault."""


def following(state: DriveState, controlword: int, before: int) -> DriveState:
    """Where one controlword leads, after the controlword `before`; the same state where the standard has no transition."""
    if state is S.fault:
        rises = controlword & FAULT_RESET and not before & FAULT_RESET
        return S.switch_on_disabled if rises else state
    _, to = TRANSITIONS.get((state, command_of(controlword)), (0, state))
    return to
