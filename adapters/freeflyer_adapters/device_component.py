"""A device as a component of the master: its step reads what is measured; its command goes out at the end of the instant."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freeflyer.component import PythonComponent
from freeflyer_adapters import simulated
from freeflyer_adapters.arm import can_arm
from freeflyer_adapters.arm import options as arm_options
from freeflyer_adapters.base import options as link_options
from freeflyer_adapters.base import zenoh_base
from freeflyer_adapters.device import Device


class DeviceComponent(PythonComponent):
    """Initialising configures the device; activating it, and writing its command, is the loop's affair (`freeflyer_adapters.hil`)."""

    variable_step = False

    def __init__(self, device: Device) -> None:
        super().__init__(device.name, list(device.ports.values()))
        self.device = device
        # One memory for both: the master copies into and out of the device's own values.
        device.values = self.values

    def initialise(self, start: float) -> None:
        self.device.configure()

    def advance(self, time: float, size: float) -> None:
        self.device.read()

    def step(self, time: float, size: float) -> None:
        self.advance(time, size)  # what is measured was checked by the device itself

    def close(self) -> None:
        self.device.deactivate()


def can_arm_component(name: str, options: Mapping[str, Any], directory: Path) -> DeviceComponent:
    return DeviceComponent(can_arm.CanArm(name, arm_options.options_from(name, options, directory)))


def zenoh_base_component(name: str, options: Mapping[str, Any], directory: Path) -> DeviceComponent:
    return DeviceComponent(zenoh_base.ZenohBase(name, link_options.options_from(name, options, directory)))


def simulated_component(name: str, options: Mapping[str, Any], directory: Path) -> DeviceComponent:
    return DeviceComponent(simulated.simulated_from(name, options, directory))
