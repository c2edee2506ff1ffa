"""The topics and messages for the signals of a run.

Each component has one topic /COMPONENT with all signals of the component. The values are not
changed. The message definition of this topic is generated from the names, sizes and units of the
signals. The units are in comments. The topic /loop contains the states of the devices and the
counters of the loop.

Some signals fit a standard ROS message. The name, the size and the unit of a signal decide which
message it fits. These signals are also written to a topic /COMPONENT/PREFIX/NAME with this message.
Tools display such a topic without configuration. In the table, PREFIX stands for the start of the
names of the signals, and may be empty. NAME is the last name in the topic. n is the number of
joints, and "base" is explained below the table. If a message contains several signals, the sizes
and units are in the same order as the signals:

| signals of one component | size and unit | message, NAME |
|---|---|---|
| PREFIXjoint_position, _velocity, _torque (or fewer) | n | sensor_msgs/JointState, joint_states |
| PREFIXposition, _orientation, _velocity (of a base) | 3 m; 4; 6 | nav_msgs/Odometry, odometry |
| PREFIXposition, _orientation (in all other cases) | 3 m; 4 | geometry_msgs/PoseStamped, pose |
| PREFIXvelocity | 6 m/s, rad/s | geometry_msgs/TwistStamped, twist |
| PREFIXacceleration | 6 m/s2, rad/s2 | geometry_msgs/AccelStamped, accel |
| PREFIXwrench | 6 N, N.m | geometry_msgs/WrenchStamped, wrench |

A body is a base if PREFIX, split at each "_", has a part that is equal to "base". If PREFIX is
empty or "true_", this test uses the name of the component instead of PREFIX. This has no effect on
the name of the topic.

The coordinate frames have the same names as on the Zenoh link. The inertial frame I has the name
"inertial", and the frame of the base has the name "base". In a nav_msgs/Odometry, the pose is
expressed in the frame "inertial". But the twist is expressed in the frame "base", because the
definition of nav_msgs/Odometry requires this.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from freeflyer.fmi.component import Array
from freeflyer.foundation.signal_name import split
from freeflyer.foundation.units import ACCELERATION, TWIST, WRENCH
from freeflyer.master.record import Signal
from freeflyer_adapters.device.device import STATE, LifeCycle
from freeflyer_adapters.recording.cdr_layout import Layout, Numbers
from freeflyer_adapters.recording.ring import Rows
from freeflyer_adapters.recording.ring_header import RecordingHeader
from freeflyer_adapters.recording.ros_definitions import (
    DEFINITIONS,
    PACKAGE,
    field_names,
    full_text,
    message_name,
)

INERTIAL, BASE = "inertial", "base"
COLUMNS = "freeflyer.columns"
"""Metadata key of /loop and of the topics /COMPONENT.

The value is JSON, [{name, size, units}, ...], in the order of the fields."""
COVARIANCE = 36
LOOP = "/loop"


@dataclass(frozen=True)
class Topic:
    name: str
    message: str
    """Type name in ROS 2, for example nav_msgs/msg/Odometry."""
    definition: str
    layout: Layout
    metadata: Mapping[str, str] = field(default_factory=dict)


def topics(header: RecordingHeader, signals: Sequence[Signal]) -> list[Topic]:
    """Return the topic of the loop, then the topics of `signals`."""
    by_component: dict[str, dict[str, Signal]] = {}
    for signal in signals:
        component, variable = split(signal.name)
        by_component.setdefault(component, {})[variable] = signal
    found = [_loop_topic(header)]
    for component, variables in by_component.items():
        found.append(_component_topic(component, variables))
        found += _standard_topics(component, variables)
    return found


def _place(component: str, *rest: str) -> str:
    names = (component, *rest)
    return "".join("/" + field_names([name])[0] for name in names if name)


def _columns(signal: Signal) -> Numbers:
    first, last = signal.first, signal.first + signal.size
    return lambda rows: rows.values[:, first:last]


# Topics with all signals


def _loop_topic(header: RecordingHeader) -> Topic:
    layout = Layout("")
    layout.numbers(2, lambda rows: rows.times[:, 1:3])
    layout.numbers(1, lambda rows: rows.times[:, 2:3] * header.tick / 1e9)
    first = header.width - len(header.loop)
    layout.numbers(len(header.loop), lambda rows: rows.values[:, first:])
    states = ", ".join(f"{state.value} {state.name}" for state in LifeCycle)
    lines = [
        "std_msgs/Header header",
        "int64 monotonic  # [ns] CLOCK_MONOTONIC of the instant",
        "int64 instant  # number of the instant",
        "float64 time  # [s] time in the scenario",
    ]
    for name, text in zip(
        field_names(["monotonic", "instant", "time", *header.loop])[3:], header.loop, strict=True
    ):
        lines.append(f"float64 {name}  # {states}" if text.endswith(STATE) else f"float64 {name}")
    columns = json.dumps([{"name": name, "size": 1, "units": [""]} for name in header.loop])
    return Topic(
        LOOP, f"{PACKAGE}/msg/Loop", full_text("\n".join(lines)), layout, {COLUMNS: columns}
    )


def _component_topic(component: str, variables: Mapping[str, Signal]) -> Topic:
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


# Topics with standard ROS messages


def _standard_topics(component: str, variables: Mapping[str, Signal]) -> list[Topic]:
    """Return the topics with standard messages. Each variable is in at most one of them."""
    found: list[Topic] = []
    done: set[str] = set()
    for variable in variables:
        for ending, units, create in (
            ("joint_position", None, _joints),
            ("joint_velocity", None, _joints),
            ("joint_torque", None, _joints),
            ("orientation", ("1",) * 4, _pose),
            ("velocity", TWIST, _twist_like("Twist")),
            ("acceleration", ACCELERATION, _twist_like("Accel")),
            ("wrench", WRENCH, _twist_like("Wrench")),
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
            topic, used = create(component, prefix, variables)
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
    moves = _has(velocity, TWIST)
    parts = (component if prefix.strip("_") in ("", "true") else prefix).split("_")
    layout = Layout(INERTIAL)
    if BASE in parts and moves and velocity is not None:
        layout.text(BASE)
        layout.numbers(3, _columns(position))
        layout.numbers(4, _columns(orientation))
        layout.zeros(COVARIANCE)  # zeros: the covariance is unknown
        layout.numbers(6, _in_body(_columns(orientation), _columns(velocity)))
        layout.zeros(COVARIANCE)
        return _topic(component, prefix, "odometry", "nav_msgs/Odometry", layout), set(names)
    layout.numbers(3, _columns(position))
    layout.numbers(4, _columns(orientation))
    return _topic(component, prefix, "pose", "geometry_msgs/PoseStamped", layout), set(names[:2])


TopicFactory = Callable[[str, str, Mapping[str, Signal]], tuple[Topic | None, set[str]]]


def _twist_like(kind: str) -> TopicFactory:
    """Return a function that creates the topic of a vector (6): linear part, then angular part."""
    ending = {"Twist": "velocity", "Accel": "acceleration", "Wrench": "wrench"}[kind]

    def create(
        component: str, prefix: str, variables: Mapping[str, Signal]
    ) -> tuple[Topic | None, set[str]]:
        layout = Layout(INERTIAL)
        layout.numbers(6, _columns(variables[prefix + ending]))
        return _topic(component, prefix, kind.lower(), f"geometry_msgs/{kind}Stamped", layout), {
            prefix + ending
        }

    return create


def _in_body(orientation: Numbers, velocity: Numbers) -> Numbers:
    """Return a function that gives the twists in the frame of the body.

    `orientation`: orientations of the body. `velocity`: the twists, expressed in I.
    """

    def numbers(rows: Rows) -> Array:
        q, v = np.asarray(orientation(rows), dtype=float), np.asarray(velocity(rows), dtype=float)
        vector, scalar = -q[:, :3], q[:, 3:]  # inverse rotation
        parts = []
        for part in (v[:, :3], v[:, 3:]):
            across = 2.0 * np.cross(vector, part)
            parts.append(part + scalar * across + np.cross(vector, across))
        return np.hstack(parts)

    return numbers
