"""Device as a component of the master. Its step reads the measurements.

The loop writes the commands at the end of the instant (`freeflyer_adapters.loop`).
"""

from __future__ import annotations

from freeflyer.fmi.component import PythonComponent
from freeflyer_adapters.device.device import Device


class DeviceComponent(PythonComponent):
    """Component of one device. Initialisation configures it; `loop.hil` activates it."""

    variable_step = False

    def __init__(self, device: Device) -> None:
        super().__init__(device.name, list(device.ports.values()), device.values)
        self.device = device

    def initialise(self, start: float) -> None:
        self.device.configure()

    def advance(self, time: float, size: float) -> None:
        self.device.read()

    def step(self, time: float, size: float) -> None:
        self.advance(time, size)  # the device checks its measurements

    def close(self) -> None:
        self.device.deactivate()
