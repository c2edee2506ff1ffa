"""A device as a component of the master: one communication step is one cycle, the last command out and the next measurement in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from adapters import can_arm, zenoh_base
from adapters.device import Device
from cosim.component import PythonComponent
from cosim.errors import ComponentError


class DeviceComponent(PythonComponent):
    """Initialising configures the device; activating it is the loop's affair (`adapters.hil`)."""

    variable_step = False

    def __init__(self, device: Device) -> None:
        super().__init__(device.name, list(device.ports.values()))
        self.device = device
        # One memory for both: the master copies into and out of the device's own values.
        device.values = self.values
        self._begun = False

    def initialise(self, start: float) -> None:
        self.device.configure()

    def advance(self, time: float, size: float) -> None:
        if self._begun:
            self.device.write()
        elif abs(size - self.device.step) > 1e-9:
            raise ComponentError(f"device {self.name} works in steps of {self.device.step:g} s; its step_s is {size:g} s")
        self._begun = True
        self.device.read()

    def step(self, time: float, size: float) -> None:
        self.advance(time, size)  # what is measured was checked by the device itself

    def close(self) -> None:
        self.device.deactivate()


def can_arm_component(name: str, options: Mapping[str, Any], directory: Path) -> DeviceComponent:
    return DeviceComponent(can_arm.CanArm(name, can_arm.options_from(name, options, directory)))


def zenoh_base_component(name: str, options: Mapping[str, Any], directory: Path) -> DeviceComponent:
    return DeviceComponent(zenoh_base.ZenohBase(name, zenoh_base.options_from(name, options, directory)))
