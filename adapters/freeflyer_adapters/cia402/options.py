"""Options of a device of the kind "cia402_arm", from the table `[devices.NAME]` of a scenario.

The host and the virtual drives use these options. The numeric settings of the table `parameters`
are defined in `freeflyer_adapters.cia402.parameters`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from freeflyer.foundation.keys import (
    ANY,
    LIST,
    WHOLE,
    Key,
    Keys,
    Type,
    between,
    expecting,
    file_path,
    read,
)
from freeflyer.foundation.toml_file import as_written
from freeflyer.scenario.keys import COMPONENT
from freeflyer_adapters.can.link import BUS
from freeflyer_adapters.cia402.objects import SHIPPED_EDS
from freeflyer_adapters.cia402.scaling import Motor
from freeflyer_adapters.foundation.errors import DeviceError


@dataclass(frozen=True, kw_only=True)
class DriveOptions:
    """Options of a bus with one drive per joint. `KEYS` describes them."""

    interface: str
    channel: str
    bus: Mapping[str, Any]
    bitrate: float
    node_ids: Sequence[int]
    host_node_id: int
    eds: Path
    motors: Sequence[Motor]
    measured_velocity: bool
    heartbeat: float
    largest_load: float

    @property
    def joints(self) -> int:
        return len(self.node_ids)


# fmt: off
_PER_JOINT = {"anyOf": [{"type": "number", "exclusiveMinimum": 0}, {"type": "array", "items": {"type": "number", "exclusiveMinimum": 0}}]}
MOTOR: Keys = {
    "rated_torque": Key(Type({}, unit="N.m"), "rated torque of the motors [N m]: one number, or a list with one number for each joint", inner=_PER_JOINT),
    "encoder_resolution": Key(ANY, "increments per revolution of the motors", default=4096.0, inner=_PER_JOINT),
    "gear_ratio": Key(ANY, "motor revolutions per joint revolution", default=1.0, inner=_PER_JOINT),
    "velocity_scale": Key(ANY, "units of 606Ch per increment/s", default=1.0, inner=_PER_JOINT),
}
KEYS: Keys = {
    **BUS,
    "bitrate": Key(between(1e4, 1e6, "bit/s"), "bit rate [bit/s]", default=1e6),
    "joints": Key(WHOLE, "number of joints", default=6),
    "node_ids": Key(LIST, "CANopen node numbers of the drives; default: 1, 2, ..."),
    "host_node_id": Key(WHOLE, "CANopen node number of the host", default=127),
    "eds": Key(file_path(), "path of the drives' EDS file, relative to the scenario; default: the shipped drive.eds"),
    **MOTOR,
    "velocity": Key(expecting({"enum": ["measured", "estimated"]}, "'measured' (TPDO2) or 'estimated' (from positions) is expected"),
                    "`\"measured\"`: the drives send velocities; `\"estimated\"`: the host computes them from positions", default="measured"),
    "heartbeat_s": Key(between(0.01, 10.0, "s"), "heartbeat period of the drives and of the host [s]", default=0.1),
    "largest_load": Key(between(0.05, 1.0), "largest allowed bus load, as a fraction", default=0.8),
}
# fmt: on


def options_from(name: str, raw: Mapping[str, Any], directory: Path) -> DriveOptions:
    """Return the options in the device's table `raw`.

    `name`: name of the device. `directory`: a relative path of an EDS starts in this directory.
    Raises DeviceError for an invalid key or value.
    """
    given = read(raw, KEYS, DeviceError, f"device {name}: ", others=COMPONENT)
    joints = given["joints"]
    if not 1 <= joints <= 126:
        raise DeviceError(f"device {name}: joints is {joints}; 1 to 126 is expected")
    columns = [_per_joint(name, key, given[key], joints) for key in MOTOR]
    motors = [
        Motor(rated_torque=rated, encoder_resolution=encoder, gear_ratio=gear, velocity_scale=scale)
        for rated, encoder, gear, scale in zip(*columns, strict=True)
    ]
    return DriveOptions(
        interface=given["interface"],
        channel=str(given["channel"]),
        bus=given["bus"],
        bitrate=float(given["bitrate"]),
        **_nodes(name, given, joints),
        eds=directory / given["eds"] if given["eds"] else SHIPPED_EDS,
        motors=motors,
        measured_velocity=given["velocity"] == "measured",
        heartbeat=float(given["heartbeat_s"]),
        largest_load=float(given["largest_load"]),
    )


def _nodes(name: str, given: Mapping[str, Any], joints: int) -> dict[str, Any]:
    """Return the node numbers of the drives and of the host.

    Raises DeviceError if two numbers are equal, or if a number is not from 1 to 127.
    """
    nodes, host = given["node_ids"], given["host_node_id"]
    nodes = range(1, joints + 1) if nodes is None else nodes
    if len(nodes) != joints:
        raise DeviceError(
            f"device {name}: node_ids has {len(nodes)} entries; one for each of {joints} joints is expected"
        )
    for node in (*nodes, host):
        if isinstance(node, bool) or not isinstance(node, int) or not 1 <= node <= 127:
            raise DeviceError(
                f"device {name}: node {node!r} is not a CANopen node number; a whole number from 1 to 127 is expected"
            )
    twice = [node for node in nodes if [*nodes, host].count(node) > 1]
    if twice:
        raise DeviceError(
            f"device {name}: node {twice[0]} occurs twice in node_ids and host_node_id; distinct numbers are expected"
        )
    return {"node_ids": tuple(nodes), "host_node_id": host}


def _per_joint(name: str, key: str, value: Any, joints: int) -> list[float]:
    """Return one number per joint. The value of `key` is a list, or one number for all joints."""
    if value is None:
        raise DeviceError(
            f"device {name}: {key} is missing; expected: one number for all drives, or a list with one number for each joint"
        )
    values = value if isinstance(value, list) else [value] * joints
    if len(values) != joints:
        raise DeviceError(
            f"device {name}: {key} has {len(values)} entries; one for each of {joints} joints is expected"
        )
    for v in values:
        if isinstance(v, bool) or not isinstance(v, int | float) or not 0.0 < v < 1e9:
            raise DeviceError(
                f"device {name}: {key} has {as_written(v)}; a number greater than zero is expected"
            )
    return [float(v) for v in values]
