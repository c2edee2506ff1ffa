"""Entry point for devices of the kind "can_arm"."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freeflyer.foundation.keys import declares
from freeflyer_adapters.arm.can_arm import CanArm
from freeflyer_adapters.arm.options import KEYS, options_from
from freeflyer_adapters.device.component import DeviceComponent


@declares(KEYS)
def can_arm_component(name: str, options: Mapping[str, Any], directory: Path) -> DeviceComponent:
    return DeviceComponent(CanArm(name, options_from(name, options, directory)))
