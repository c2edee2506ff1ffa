"""Command, state and description frames of an arm.

Role: name of a quantity in a frame, for example `joint_position`. A mapping assigns the signals of
a DBC to the roles. The shipped `arm.dbc` needs no mapping. For a user's DBC, the mapping contains
the names of the messages and signals.

Both ends of a link use `ArmFrames`. The host packs commands and unpacks states. The virtual arm is
the simulated other end: it unpacks commands and packs states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

from freeflyer.foundation.keys import (
    ANY,
    TABLE,
    WHOLE,
    Key,
    Keys,
    expecting,
    read,
    setting,
    table_schema,
    whole,
)
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer_adapters.can.frame import Frame
from freeflyer_adapters.can.signals import Field, field_of, load, message_of
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.foundation.errors import DeviceError

SHIPPED_DBC = Path(__file__).parent / "arm.dbc"
CYCLE_ROLES = ("cycle", "answered_cycle", "echoed_cycle")
FEWEST_CYCLES = 64
"""Smallest accepted modulus of the cycle numbers."""


class Mode(IntEnum):
    """Requested mode in a command frame."""

    idle = 0
    torque = 1
    brake = 2
    reset = 3
    """Asks the arm to accept the session number, which identifies one activation by this host.

    An arm in the state safe_stop or fault also changes to the state inactive.
    """
    activate = 4
    """Releases the brakes of an inactive arm that has echoed the session number."""


@dataclass(frozen=True, kw_only=True)
class Role:
    """Name, signal and unit of a quantity in a frame.

    `signal`: name of the signal in the shipped DBC. `per_joint`: whether each joint has one signal.
    If True, `{}` in `signal` stands for the number of the joint. `required`: whether every DBC must
    contain this role.
    """

    name: str
    signal: str
    unit: str | None = None
    per_joint: bool = False
    required: bool = False


def _roles(*rows: tuple[str, str, str | None, bool, bool]) -> tuple[Role, ...]:
    return tuple(Role(name=n, signal=s, unit=u, per_joint=j, required=r) for n, s, u, j, r in rows)


ROLES: Mapping[str, tuple[Role, ...]] = {
    "command": _roles(
        ("answered_cycle", "AnsweredCycle", None, False, False),
        ("controller", "Controller", None, False, False),
        ("mode", "Mode", None, False, False),
        ("joint_torque_command", "TorqueCommand{}", "N.m", True, True),
    ),
    "state": _roles(
        ("cycle", "Cycle", None, False, True),
        ("echoed_cycle", "EchoedCycle", None, False, False),
        ("obeyed_controller", "Controller", None, False, False),
        ("life_cycle", "LifeCycle", None, False, False),
        ("brakes", "BrakesEngaged", None, False, False),
        ("command_age", "CommandAge", None, False, False),
        ("joint_position", "Position{}", "rad", True, True),
        ("joint_velocity", "Velocity{}", "rad/s", True, True),
        ("joint_torque", "Torque{}", "N.m", True, True),
    ),
    "description": _roles(
        ("joint_count", "JointCount", None, False, True),
        ("cycle_time", "CycleTime", "s", False, False),
        ("joint_lower_limit", "LowerLimit{}", "rad", True, False),
        ("joint_upper_limit", "UpperLimit{}", "rad", True, False),
        ("joint_velocity_limit", "VelocityLimit{}", "rad/s", True, False),
        ("joint_effort_limit", "TorqueLimit{}", "N.m", True, False),
    ),
}
CONSEQUENCES: Mapping[str, str] = {
    "mode_values.activate": "a single torque frame activates the arm, even if the frame is late",
    "controller": "the arm accepts commands of an earlier run, or of another controller",
    "obeyed_controller": "the controllers cannot detect that the arm accepts commands from another run or controller",
    "answered_cycle": "the arm cannot distinguish a late command from a new command",
    "life_cycle": "the controllers cannot detect that the arm has stopped by itself",
    "brakes": "the controllers cannot detect whether the brakes are engaged, and assume that the arm is at rest at the end of the ramp-down",
    "echoed_cycle": "the controllers do not count late commands, and accept a delayed state frame as a new state frame",
}
"""Effect of a missing role, or of a missing number for the mode `activate`."""
NEEDED = ("mode_values.activate", "controller", "obeyed_controller", "answered_cycle", "life_cycle")
"""If one of these entries is missing, the arm cannot reject a late activation.

A late activation is an activation that the present run has not requested.
"""
MESSAGES = {"command": "ArmCommand", "state": "ArmState", "description": "ArmDescription"}
LIMIT_ROLES = (
    "joint_lower_limit",
    "joint_upper_limit",
    "joint_velocity_limit",
    "joint_effort_limit",
)


_MESSAGE = expecting({"type": "string"}, "the name of a message is expected")
_NUMBER = whole(0, 1 << 32)
TABLES: Mapping[str, Keys] = {
    "messages": dict.fromkeys(ROLES, Key(_MESSAGE, "name of the message")),
    "signals": {r.name: Key(ANY, "name of the signal") for rows in ROLES.values() for r in rows},
    "data_ids": dict.fromkeys(ROLES, Key(whole(0, 0xFFFF), "E2E data ID of the frame")),
    "mode_values": {mode.name: Key(_NUMBER, "raw number of the mode") for mode in Mode},
    "life_cycle_values": {s.name: Key(_NUMBER, "raw number of the state") for s in LifeCycle},
}
"""Keys of the tables of a mapping."""


def _table(name: str, meaning: str) -> Any:
    return setting(Key(TABLE, meaning, default={}, inner=table_schema(TABLES[name])))


@dataclass(frozen=True, kw_only=True)
class FrameMapping:
    """DBC of a scenario, and the names and numbers in this DBC.

    An empty table selects the names and numbers of the shipped DBC. The frames are called
    "command", "state" and "description".
    """

    dbc: Path = SHIPPED_DBC
    # fmt: off
    messages: Mapping[str, str] = _table("messages", "frame (`command`, `state`, `description`) -> name of the message")
    signals: Mapping[str, Any] = _table("signals", "role -> name of the signal. For a role with one signal per joint, the name contains `{}` for the number of the joint. A list of names is also possible")
    data_ids: Mapping[str, int] = _table("data_ids", "frame -> E2E data ID. E2E protection needs an entry if the DBC has no attribute E2eDataId")
    e2e_offset: int = setting(Key(WHOLE, "first byte of the E2E header", default=0))
    mode_values: Mapping[str, int] = _table("mode_values", "mode -> raw number in the DBC. Needed if the number differs from the number in the shipped DBC")
    life_cycle_values: Mapping[str, int] = _table("life_cycle_values", "state -> raw number in the DBC. Needed if the number differs from the number in the shipped DBC")
    # fmt: on

    @property
    def has_shipped_names(self) -> bool:
        """Whether the messages and signals have the names of the shipped DBC."""
        if self.dbc == SHIPPED_DBC:
            return True
        if self.messages or self.signals:
            return False
        return self._names_all("command", "state")

    def _names_all(self, *kinds: str) -> bool:
        """Return whether the DBC has all shipped message and signal names of the frames `kinds`."""
        frames = {
            message.name: {signal.name for signal in message.signals}
            for message in load(self.dbc).messages
        }
        return all(
            role.signal.replace("{}", "1") in frames.get(MESSAGES[kind], ())
            for kind in kinds
            for role in ROLES[kind]
        )

    @property
    def has_description(self) -> bool:
        """Whether the arm sends a description frame.

        The arm sends it if `messages` contains the frame, or if all frames in the DBC, including
        the description frame, have the shipped names.
        """
        if "description" in self.messages or self.dbc == SHIPPED_DBC:
            return True
        return self.has_shipped_names and self._names_all("description")


def _frame(kind: str, mapping: FrameMapping, joints: int) -> Frame:
    message = message_of(load(mapping.dbc), mapping.messages.get(kind, MESSAGES[kind]), mapping.dbc)
    present = {signal.name for signal in message.signals}
    names = {role: _names(role, mapping, joints, present) for role in ROLES[kind]}
    return Frame(
        message,
        {
            role.name: tuple(
                field_of(message, name, role.unit, mapping.dbc) for name in names[role]
            )
            for role in ROLES[kind]
            if names[role]
        },
        subject=f"DBC {mapping.dbc}: message {message.name}",
        data_id=mapping.data_ids.get(kind),
        e2e_offset=mapping.e2e_offset,
    )


def _names(role: Role, mapping: FrameMapping, joints: int, present: set[str]) -> list[str]:
    """Return the signal names of a role, or [] if an optional role is not mapped.

    `present`: names of all signals in the message. Raises DeviceError if the mapping of the role is
    invalid, or if a name is not in `present`.
    """
    given = mapping.signals.get(role.name)
    if given is None and not role.required and not mapping.has_shipped_names:
        return []  # optional signals of a user's DBC are used only if they are mapped
    pattern = role.signal if given is None else given
    if not role.per_joint:
        if not isinstance(pattern, str):
            raise DeviceError(
                f"signals.{role.name} is {pattern!r}; the name of one signal is expected"
            )
        names = [pattern]
    elif isinstance(pattern, str):
        names = [pattern.replace("{}", str(i + 1)) for i in range(joints)]
    else:
        if not isinstance(pattern, list) or not all(isinstance(name, str) for name in pattern):
            raise DeviceError(
                f"signals.{role.name} is {pattern!r}; expected: a name with {{}} for the number of the joint, or a list of names"
            )
        names = list(pattern)
        if len(names) != joints:
            raise DeviceError(
                f"signals.{role.name} names {len(names)} signals; {joints} are expected, one for each joint"
            )
    missing = [name for name in names if name not in present]
    if missing:
        raise DeviceError(
            f"DBC {mapping.dbc} lacks the signal {missing[0]!r} of signals.{role.name}{did_you_mean(missing[0], sorted(present))}"
        )
    return names


def _check_values(title: str, numbers: Mapping[Any, int], fields: Sequence[Field] | None) -> None:
    """Raise DeviceError if a number is used twice, or if its signal cannot represent the number.

    `title`: name of the table in error messages. `numbers`: mode or state -> raw number. `fields`:
    the signal, or None if the frame has no such signal.
    """
    for name, number in numbers.items():
        if list(numbers.values()).count(number) > 1:
            raise DeviceError(
                f"{title}: {name.name} has the number {number}, but another name has the same number; all numbers must differ, including the defaults"
            )
        if fields and not fields[0].least <= number <= fields[0].most:
            raise DeviceError(
                f"{title}: {name.name} has the number {number}, but its signal {fields[0].name} holds {fields[0].most:g} at most"
            )


class ArmFrames:
    """Command frame, state frame and optional description frame of an arm."""

    def __init__(self, mapping: FrameMapping, joints: int) -> None:
        """Assign signals to the roles. Raises DeviceError if the DBC or mapping cannot be used."""
        # The frames need different identifiers: two nodes must not send the same identifier.
        for table, keys in TABLES.items():
            prefix, unknown = f"{table}.", "{name!r} in the mapping of the DBC is unknown"
            read(getattr(mapping, table), keys, DeviceError, subject=prefix, unknown=unknown)
        self.mapping, self.joints = mapping, joints
        self.command = _frame("command", mapping, joints)
        self.state = _frame("state", mapping, joints)
        if (self.command.identifier, self.command.extended) == (
            self.state.identifier,
            self.state.extended,
        ):
            raise DeviceError(
                f"DBC {mapping.dbc}: {self.command.message.name} and {self.state.message.name} have the same identifier "
                f"0x{self.state.identifier:X}, but two nodes must not send frames with the same identifier"
            )
        self.description: Frame | None = None
        if mapping.has_description:
            self.description = _frame("description", mapping, joints)
        # Several signals contain a cycle number. The shortest of these signals limits the cycle
        # numbers. The same applies to the session numbers.
        numbers = [
            f.fields[r][0].most for f in (self.command, self.state) for r in CYCLE_ROLES if r in f
        ]
        self.cycles = int(min(numbers)) + 1
        """Modulus of the cycle numbers."""
        if self.cycles < FEWEST_CYCLES:
            raise DeviceError(
                f"DBC {mapping.dbc}: the cycle number has only {int(min(numbers)).bit_length()} bits; at least {FEWEST_CYCLES} "
                f"different cycle numbers are expected"
            )
        named = [
            f.fields[r][0].most
            for f, r in ((self.command, "controller"), (self.state, "obeyed_controller"))
            if r in f
        ]
        self.controllers = int(min(named, default=0xFFFF))
        """Largest session number."""
        # Store the raw numbers of the modes and states.
        self._modes = {mode: int(mapping.mode_values.get(mode.name, mode)) for mode in Mode}
        if not mapping.has_shipped_names and "activate" not in mapping.mode_values:
            del self._modes[Mode.activate]
        self._states = {
            int(mapping.life_cycle_values.get(state.name, state)): state for state in LifeCycle
        }
        _check_values("mode_values", self._modes, self.command.fields.get("mode"))
        _check_values(
            "life_cycle_values",
            {s: r for r, s in self._states.items()},
            self.state.fields.get("life_cycle"),
        )
        if len(self._states) < len(LifeCycle):
            raise DeviceError(
                "life_cycle_values: two states have the same number; all numbers must differ, including the defaults"
            )
        self._mode_of = {raw: mode for mode, raw in self._modes.items()}
        self._state_of = {state: raw for raw, state in self._states.items()}

    @property
    def missing(self) -> list[str]:
        """Keys of `CONSEQUENCES` that are missing in the DBC or in the mapping."""
        present = {"mode_values.activate": Mode.activate in self._modes and "mode" in self.command}
        roles = {*self.command.fields, *self.state.fields}
        return [name for name in CONSEQUENCES if not present.get(name, name in roles)]

    def check_activation(self, subject: str, implicit: bool) -> None:
        """Raise DeviceError if the arm cannot reject a late activation (see NEEDED).

        `subject`: name of the arm in the error message. `implicit`: whether the scenario accepts an
        arm that cannot reject a late activation.
        """
        missing = [name for name in self.missing if name in NEEDED]
        if missing and not implicit:
            raise DeviceError(
                f"{subject}: DBC {self.mapping.dbc} has no {', '.join(missing)}, so the arm itself cannot reject a late activation "
                f'(interface control document, "What a DBC may lack"); map all signals that the arm has, or write '
                f'activation = "implicit"'
            )

    def cannot_refuse(self, implicit: bool) -> list[str]:
        """Return sentences about what this arm cannot reject or report by itself.

        `implicit`: whether the scenario has the option `activation = "implicit"`.
        """
        limits = [f"without {name}, {CONSEQUENCES[name]}" for name in self.missing]
        if implicit and not any(name in NEEDED for name in self.missing):
            limits.append(f'with activation = "implicit", {CONSEQUENCES["mode_values.activate"]}')
        return limits

    @property
    def is_fd(self) -> bool:
        return self.command.is_fd or self.state.is_fd

    def mode_number(self, mode: Mode) -> int:
        return self._modes[mode]

    def mode(self, number: float) -> Mode | None:
        return self._mode_of.get(int(number))

    def life_cycle_number(self, state: LifeCycle) -> int:
        return self._state_of[state]

    def life_cycle(self, number: float) -> LifeCycle | None:
        return self._states.get(int(number))

    def check_ranges(self, needed: Mapping[str, Sequence[tuple[float, float]]]) -> None:
        """Raise DeviceError if a signal cannot represent the range that the robot needs.

        `needed`: role -> one pair (smallest value, largest value) per joint, in SI units.
        """
        for frame in (self.command, self.state):
            for role, ranges in needed.items():
                if role not in frame:
                    continue
                for f, (least, most) in zip(frame.fields[role], ranges, strict=True):
                    if f.least > least + f.resolution or f.most < most - f.resolution:
                        unit = next(
                            r.unit for rows in ROLES.values() for r in rows if r.name == role
                        )
                        raise DeviceError(
                            f"{frame.subject}: signal {f.name} holds {f.least:.6g} to {f.most:.6g} {unit}, but the robot needs {least:.6g} "
                            f"to {most:.6g} {unit}; give the signal more bits or a coarser scale"
                        )
