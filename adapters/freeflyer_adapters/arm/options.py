"""Options of a device of the kind "can_arm", from the table `[devices.NAME]` of a scenario.

Both ends of the link, the host and the virtual arm, use these options. The numeric settings of the
table `parameters` are defined in `freeflyer_adapters.device.parameters`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from freeflyer_adapters.arm.frames import FrameMapping
from freeflyer_adapters.device.option_checks import checked, known_keys
from freeflyer_adapters.foundation.errors import DeviceError

ACTIVATIONS = ("explicit", "implicit")


@dataclass(frozen=True, kw_only=True)
class ArmOptions:
    """Options of the link to one arm.

    `bus`: further arguments of the python-can interface, for example bit rates. `joints`: number of
    joints of the robot.
    """

    interface: str = "local"
    channel: str = "freeflyer"
    bus: Mapping[str, Any] = field(default_factory=dict)
    joints: int = 6
    frames: FrameMapping = field(default_factory=FrameMapping)
    implicit: bool = False
    """True for `activation = "implicit"`.

    Such an arm has no mode `activate`. A torque frame activates the arm.
    """


def options_from(name: str, raw: Mapping[str, Any], directory: Path) -> ArmOptions:
    """Return the options from the device's table `raw`.

    `name`: name of the device. `directory`: relative paths of a DBC start in this directory. Raises
    DeviceError for an unknown key or an invalid value.
    """
    known_keys(name, raw, ("interface", "channel", "bus", "joints", "dbc", "messages", "signals", "data_ids", "e2e_offset",
                           "mode_values", "life_cycle_values", "activation"))  # fmt: skip
    dbc = checked(name, raw, "dbc", str, "")
    mapping = FrameMapping(
        **({"dbc": directory / dbc} if dbc else {}),
        messages=checked(name, raw, "messages", dict, {}),
        signals=checked(name, raw, "signals", dict, {}),
        data_ids=checked(name, raw, "data_ids", dict, {}),
        e2e_offset=checked(name, raw, "e2e_offset", int, 0),
        mode_values=checked(name, raw, "mode_values", dict, {}),
        life_cycle_values=checked(name, raw, "life_cycle_values", dict, {}),
    )
    activation = checked(name, raw, "activation", str, ACTIVATIONS[0])
    if activation not in ACTIVATIONS:
        raise DeviceError(
            f"device {name}: activation is {activation!r}; {' or '.join(map(repr, ACTIVATIONS))} is expected"
        )
    return ArmOptions(
        interface=checked(name, raw, "interface", str, "local"),
        channel=str(raw.get("channel", "freeflyer")),
        bus=checked(name, raw, "bus", dict, {}),
        joints=checked(name, raw, "joints", int, 6),
        frames=mapping,
        implicit=activation == "implicit",
    )
