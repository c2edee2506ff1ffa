"""A device as a component of the master: its step reads what is measured; its command goes out at the end of the instant."""

from __future__ import annotations

from freeflyer.fmi.component import PythonComponent
from freeflyer_adapters.device.device import Device


class DeviceComponent(PythonComponent):
    """Initialising configures the device; activating it, and writing its command, is the loop's affair (`freeflyer_adapters.loop.hil`)."""

    variable_step = False

    def __init__(self, device: Device) -> None:
        super().__init__(device.name, list(device.ports.values()), device.values)
        self.device = device

    def initialise(self, start: float) -> None:
        self.device.configure()

    def advance(self, time: float, size: float) -> None:
        self.device.read()

    def step(self, time: float, size: float) -> None:
        self.advance(time, size)  # what is measured was checked by the device itself

    def close(self) -> None:
        self.device.deactivate()
