"""Entry point for devices of the kind "cia402_arm"."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freeflyer.foundation.keys import declares
from freeflyer_adapters.cia402.arm import Cia402Arm
from freeflyer_adapters.cia402.options import KEYS, options_from
from freeflyer_adapters.device.component import DeviceComponent


@declares(KEYS)
def cia402_arm_component(name: str, options: Mapping[str, Any], directory: Path) -> DeviceComponent:
    return DeviceComponent(Cia402Arm(name, options_from(name, options, directory)))
