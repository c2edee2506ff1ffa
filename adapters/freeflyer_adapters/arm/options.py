"""Options of a device of the kind "can_arm", from the table `[devices.NAME]` of a scenario.

Both ends of the link, the host and the virtual arm, use these options. The numeric settings of the
table `parameters` are defined in `freeflyer_adapters.device.parameters`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from freeflyer.foundation.keys import WHOLE, Key, Keys, choice, file_path, keys_of, read, setting
from freeflyer.scenario.keys import COMPONENT
from freeflyer_adapters.arm.frames import FrameMapping
from freeflyer_adapters.can.link import BUS
from freeflyer_adapters.foundation.errors import DeviceError


@dataclass(frozen=True, kw_only=True)
class ArmOptions:
    """Options of the link to one arm. `KEYS` describes them."""

    interface: str = setting(BUS["interface"])
    channel: str = setting(BUS["channel"])
    bus: Mapping[str, Any] = setting(BUS["bus"])
    joints: int = setting(Key(WHOLE, "number of joints", default=6))
    frames: FrameMapping = field(default_factory=FrameMapping)
    implicit: bool = False
    """True for `activation = "implicit"`.

    Such an arm has no mode `activate`. A torque frame activates the arm.
    """


MAPPING = keys_of(FrameMapping)
# fmt: off
KEYS: Keys = {
    **keys_of(ArmOptions),
    "dbc": Key(file_path(), "path of the DBC, relative to the scenario; default: the shipped arm.dbc"),
    **MAPPING,
    "activation": Key(choice("explicit", "implicit"), "`\"implicit\"`: a torque frame activates the arm, which has no mode `activate`", default="explicit"),
}
# fmt: on


def options_from(name: str, raw: Mapping[str, Any], directory: Path) -> ArmOptions:
    """Return the options from the device's table `raw`.

    `name`: name of the device. `directory`: relative paths of a DBC start in this directory. Raises
    DeviceError for an unknown key or an invalid value.
    """
    given = read(raw, KEYS, DeviceError, f"device {name}: ", others=COMPONENT)
    return ArmOptions(
        interface=given["interface"],
        channel=str(given["channel"]),
        bus=given["bus"],
        joints=given["joints"],
        frames=FrameMapping(
            **({"dbc": directory / given["dbc"]} if given["dbc"] else {}),
            **{key: given[key] for key in MAPPING},
        ),
        implicit=given["activation"] == "implicit",
    )
