"""Options of a device of the kind "cia402_arm", from the table `[devices.NAME]` of a scenario.

The host and the virtual drives use these options. The numeric settings of the table `parameters`
are defined in `freeflyer_adapters.cia402.parameters`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from freeflyer_adapters.cia402.objects import SHIPPED_EDS
from freeflyer_adapters.cia402.scaling import Motor
from freeflyer_adapters.device.option_checks import checked, known_keys
from freeflyer_adapters.foundation.errors import DeviceError

KEYS = ("interface", "channel", "bus", "bitrate", "joints", "node_ids", "host_node_id", "eds", "rated_torque", "encoder_resolution",
        "gear_ratio", "velocity_scale", "velocity", "heartbeat_s", "largest_load")  # fmt: skip
VELOCITIES = ("measured", "estimated")


@dataclass(frozen=True, kw_only=True)
class DriveOptions:
    """Options of a bus with one drive per joint.

    - `bus`: further arguments of the python-can interface.
    - `bitrate` [bit/s].
    - `node_ids`, `motors`: one value for each joint.
    - `eds`: file with the object dictionary of the drives.
    - `measured_velocity`: whether the drives send measured velocities (TPDO2). Otherwise the host
      estimates velocities from positions.
    - `heartbeat`: heartbeat period of the drives and of the host [s].
    - `largest_load`: largest allowed bus load, as a fraction.
    """

    interface: str = "local"
    channel: str = "freeflyer"
    bus: Mapping[str, Any] = field(default_factory=dict)
    bitrate: float = 1e6
    node_ids: Sequence[int]
    host_node_id: int = 127
    eds: Path = SHIPPED_EDS
    motors: Sequence[Motor]
    measured_velocity: bool = True
    heartbeat: float = 0.1
    largest_load: float = 0.8

    @property
    def joints(self) -> int:
        return len(self.node_ids)


def options_from(name: str, raw: Mapping[str, Any], directory: Path) -> DriveOptions:
    """Return the options in the device's table `raw`.

    `name`: name of the device. `directory`: a relative path of an EDS starts in this directory.
    Raises DeviceError for an invalid key or value.
    """
    known_keys(name, raw, KEYS)
    joints = checked(name, raw, "joints", int, 6)
    if not 1 <= joints <= 126:
        raise DeviceError(f"device {name}: joints is {joints}; 1 to 126 is expected")
    velocity = checked(name, raw, "velocity", str, "measured")
    if velocity not in VELOCITIES:
        raise DeviceError(
            f"device {name}: velocity is {velocity!r}; 'measured' (TPDO2) or 'estimated' (from positions) is expected"
        )
    eds = checked(name, raw, "eds", str, "")
    columns = [
        _per_joint(name, raw, key, joints, default)
        for key, default in (
            ("rated_torque", None),
            ("encoder_resolution", 4096.0),
            ("gear_ratio", 1.0),
            ("velocity_scale", 1.0),
        )
    ]
    motors = [
        Motor(rated_torque=rated, encoder_resolution=encoder, gear_ratio=gear, velocity_scale=scale)
        for rated, encoder, gear, scale in zip(*columns, strict=True)
    ]
    return DriveOptions(
        interface=checked(name, raw, "interface", str, "local"),
        channel=str(raw.get("channel", "freeflyer")),
        bus=checked(name, raw, "bus", dict, {}),
        bitrate=_number(name, raw, "bitrate", 1e6, 1e4, 1e6),
        **_nodes(name, raw, joints),
        eds=directory / eds if eds else SHIPPED_EDS,
        motors=motors,
        measured_velocity=velocity == "measured",
        heartbeat=_number(name, raw, "heartbeat_s", 0.1, 0.01, 10.0),
        largest_load=_number(name, raw, "largest_load", 0.8, 0.05, 1.0),
    )


def _nodes(name: str, raw: Mapping[str, Any], joints: int) -> dict[str, Any]:
    """Return the node numbers of the drives and of the host.

    Raises DeviceError if two numbers are equal, or if a number is not from 1 to 127.
    """
    nodes = checked(name, raw, "node_ids", list, list(range(1, joints + 1)))
    host = checked(name, raw, "host_node_id", int, 127)
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


def _number(
    name: str, raw: Mapping[str, Any], key: str, default: float, least: float, most: float
) -> float:
    value = raw.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise DeviceError(
            f"device {name}: {key} is {value!r}; a number from {least:g} to {most:g} is expected"
        )
    return float(value)


def _per_joint(
    name: str, raw: Mapping[str, Any], key: str, joints: int, default: float | None
) -> list[float]:
    """Return one number per joint. The value of `key` is a list, or one number for all joints."""
    value = raw.get(key, default)
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
                f"device {name}: {key} has {v!r}; a number greater than zero is expected"
            )
    return [float(v) for v in values]
