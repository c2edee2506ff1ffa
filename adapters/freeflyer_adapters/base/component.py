"""The entry point of kind "zenoh_base"."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freeflyer.foundation.keys import declares
from freeflyer_adapters.base.options import KEYS, options_from
from freeflyer_adapters.base.zenoh_base import ZenohBase
from freeflyer_adapters.device.component import DeviceComponent


@declares(KEYS)
def zenoh_base_component(name: str, options: Mapping[str, Any], directory: Path) -> DeviceComponent:
    return DeviceComponent(ZenohBase(name, options_from(name, options, directory)))
