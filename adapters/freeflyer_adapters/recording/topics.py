"""Which messages a run's signals become. A signal's variable, size and unit decide; no scenario is known here.

Every component's signals, exactly as they are, in one message of the component's own (topic /COMPONENT, definition made from the
scenario, units in its comments); the loop's states and counters likewise (topic /loop). Beside them, so that tools show them without
being told, those that ROS has messages for:

| variables of one component (PREFIX may be empty) | size, unit | message, topic |
|---|---|---|
| PREFIXjoint_position, _velocity, _torque, or some of them | n, any of rad, m, N.m, N | sensor_msgs/JointState, /COMPONENT/PREFIX/joint_states |
| PREFIXposition, PREFIXorientation, PREFIXvelocity of a base | 3 m; 4; 6 m/s, rad/s | nav_msgs/Odometry, .../odometry |
| PREFIXposition, PREFIXorientation of anything else | 3 m; 4 | geometry_msgs/PoseStamped, .../pose |
| PREFIXvelocity | 6 m/s, rad/s | geometry_msgs/TwistStamped, .../twist |
| PREFIXacceleration | 6 m/s2, rad/s2 | geometry_msgs/AccelStamped, .../accel |
| PREFIXwrench | 6 N, N.m | geometry_msgs/WrenchStamped, .../wrench |

"Of a base": the prefix, or the component's name where the prefix has no body in it, has the word base. Frames are those of the
messages on the wire: I is "inertial"; an Odometry's twist is expressed in its child frame "base", as its definition demands.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from freeflyer.fmi.component import Array
from freeflyer.foundation.signal_name import split
from freeflyer.master.record import Signal
from freeflyer_adapters.device.device import STATE, LifeCycle
from freeflyer_adapters.recording.header import RecordingHeader
from freeflyer_adapters.recording.layout import Layout, Numbers
from freeflyer_adapters.recording.ring import Rows
from freeflyer_adapters.recording.ros_definitions import (
    DEFINITIONS,
    PACKAGE,
    field_names,
    full_text,
    message_name,
)

INERTIAL, BASE = "inertial", "base"
COLUMNS = "freeflyer.columns"
"""Metadata of the channels that hold everything: JSON, [{name, size, units}, ...] in the order of a message's fields."""
COVARIANCE = 36
LOOP = "/loop"


@dataclass(frozen=True)
class Topic:
    name: str
    message: str
    """As ROS 2 names it, with /msg/."""
    definition: str
    layout: Layout
    metadata: Mapping[str, str] = field(default_factory=dict)


def topics(head: RecordingHeader, signals: Sequence[Signal]) -> list[Topic]:
    """Of the chosen signals of a run; the loop's own topic is always among them."""
    by_component: dict[str, dict[str, Signal]] = {}
    for signal in signals:
        component, variable = split(signal.name)
        by_component.setdefault(component, {})[variable] = signal
    found = [_loop(head)]
    for component, variables in by_component.items():
        found.append(_everything(component, variables))
        found += _known(component, variables)
    return found


def _place(component: str, *rest: str) -> str:
    names = (component, *rest)
    return "".join("/" + field_names([name])[0] for name in names if name)


def _columns(signal: Signal) -> Numbers:
    first, last = signal.first, signal.first + signal.size
    return lambda rows: rows.values[:, first:last]


# Everything, as it is


def _loop(head: RecordingHeader) -> Topic:
    layout = Layout("")
    layout.numbers(2, lambda rows: rows.times[:, 1:3])
    layout.numbers(1, lambda rows: rows.times[:, 2:3] * head.tick / 1e9)
    first = head.width - len(head.loop)
    layout.numbers(len(head.loop), lambda rows: rows.values[:, first:])
    states = ", ".join(f"{state.value} {state.name}" for state in LifeCycle)
    lines = [
        "std_msgs/Header header",
        "int64 monotonic  # [ns] CLOCK_MONOTONIC of the instant",
        "int64 instant  # its number",
        "float64 time  # [s] of the scenario",
    ]
    for name, text in zip(
        field_names(["monotonic", "instant", "time", *head.loop])[3:], head.loop, strict=True
    ):
        lines.append(f"float64 {name}  # {states}" if text.endswith(STATE) else f"float64 {name}")
    columns = json.dumps([{"name": name, "size": 1, "units": [""]} for name in head.loop])
    return Topic(
        LOOP, f"{PACKAGE}/msg/Loop", full_text("\n".join(lines)), layout, {COLUMNS: columns}
    )


def _everything(component: str, variables: Mapping[str, Signal]) -> Topic:
    layout = Layout("")
    lines = ["std_msgs/Header header"]
    for name, (variable, signal) in zip(
        field_names(list(variables)), variables.items(), strict=True
    ):
        layout.numbers(signal.size, _columns(signal))
        units = list(dict.fromkeys(unit or "1" for unit in signal.units))
        note = f"  # {variable} [{', '.join(units)}]".replace("\n", " ")
        lines.append(
            (f"float64 {name}" if signal.size == 1 else f"float64[{signal.size}] {name}") + note
        )
    columns = [
        {"name": s.name, "size": s.size, "units": [unit or "" for unit in s.units]}
        for s in variables.values()
    ]
    message = f"{PACKAGE}/msg/{message_name(component)}"
    return Topic(
        _place(component),
        message,
        full_text("\n".join(lines)),
        layout,
        {COLUMNS: json.dumps(columns)},
    )


# What ROS has messages for


def _known(component: str, variables: Mapping[str, Signal]) -> list[Topic]:
    found: list[Topic] = []
    done: set[str] = set()
    for variable in variables:
        for ending, units, made in (
            ("joint_position", None, _joints),
            ("joint_velocity", None, _joints),
            ("joint_torque", None, _joints),
            ("orientation", ("1",) * 4, _pose),
            ("velocity", ("m/s",) * 3 + ("rad/s",) * 3, _six("Twist")),
            ("acceleration", ("m/s2",) * 3 + ("rad/s2",) * 3, _six("Accel")),
            ("wrench", ("N",) * 3 + ("N.m",) * 3, _six("Wrench")),
        ):
            signal = variables[variable]
            if (
                variable in done
                or not variable.endswith(ending)
                or (units is not None and not _has(signal, units))
            ):
                continue
            prefix = variable.removesuffix(ending)
            if prefix and not prefix.endswith("_"):
                continue
            topic, used = made(component, prefix, variables)
            if topic is not None:
                found.append(topic)
                done |= used
                break
    return found


def _has(signal: Signal | None, units: Sequence[str]) -> bool:
    return signal is not None and tuple(unit or "1" for unit in signal.units) == tuple(units)


def _topic(component: str, prefix: str, ending: str, kind: str, layout: Layout) -> Topic:
    package, name = kind.split("/")
    return Topic(
        _place(component, prefix.strip("_"), ending),
        f"{package}/msg/{name}",
        full_text(DEFINITIONS[kind]),
        layout,
    )


def _joints(
    component: str, prefix: str, variables: Mapping[str, Signal]
) -> tuple[Topic | None, set[str]]:
    names = [f"{prefix}joint_{part}" for part in ("position", "velocity", "torque")]
    parts = [variables.get(name) for name in names]
    size = max(part.size for part in parts if part is not None)
    parts = [part if part is not None and part.size == size else None for part in parts]
    layout = Layout("")
    layout.texts([f"joint_{i + 1}" for i in range(size)])
    for part in parts:
        layout.length(0 if part is None else size)
        if part is not None:
            layout.numbers(size, _columns(part))
    used = {name for name, part in zip(names, parts, strict=True) if part is not None}
    return _topic(component, prefix, "joint_states", "sensor_msgs/JointState", layout), used


def _pose(
    component: str, prefix: str, variables: Mapping[str, Signal]
) -> tuple[Topic | None, set[str]]:
    names = [f"{prefix}{part}" for part in ("position", "orientation", "velocity")]
    position, orientation, velocity = (variables.get(name) for name in names)
    if position is None or orientation is None or not _has(position, ("m",) * 3):
        return None, set()
    moves = _has(velocity, ("m/s",) * 3 + ("rad/s",) * 3)
    words = prefix.split("_") if prefix.strip("_") not in ("", "true") else component.split("_")
    layout = Layout(INERTIAL)
    if BASE in words and moves and velocity is not None:
        layout.text(BASE)
        layout.numbers(3, _columns(position))
        layout.numbers(4, _columns(orientation))
        layout.zeros(COVARIANCE)  # zeros: unknown
        layout.numbers(6, _in_body(_columns(orientation), _columns(velocity)))
        layout.zeros(COVARIANCE)
        return _topic(component, prefix, "odometry", "nav_msgs/Odometry", layout), set(names)
    layout.numbers(3, _columns(position))
    layout.numbers(4, _columns(orientation))
    return _topic(component, prefix, "pose", "geometry_msgs/PoseStamped", layout), set(names[:2])


Made = Callable[[str, str, Mapping[str, Signal]], tuple[Topic | None, set[str]]]


def _six(kind: str) -> Made:
    ending = {"Twist": "velocity", "Accel": "acceleration", "Wrench": "wrench"}[kind]

    def made(
        component: str, prefix: str, variables: Mapping[str, Signal]
    ) -> tuple[Topic | None, set[str]]:
        layout = Layout(INERTIAL)
        layout.numbers(6, _columns(variables[prefix + ending]))
        return _topic(component, prefix, kind.lower(), f"geometry_msgs/{kind}Stamped", layout), {
            prefix + ending
        }

    return made


def _in_body(orientation: Numbers, velocity: Numbers) -> Numbers:
    """Linear and angular velocity, expressed in I, turned into the frame of the body."""

    def numbers(rows: Rows) -> Array:
        q, v = np.asarray(orientation(rows), dtype=float), np.asarray(velocity(rows), dtype=float)
        vector, scalar = -q[:, :3], q[:, 3:]  # the inverse turn
        parts = []
        for part in (v[:, :3], v[:, 3:]):
            across = 2.0 * np.cross(vector, part)
            parts.append(part + scalar * across + np.cross(vector, across))
        return np.hstack(parts)

    return numbers
