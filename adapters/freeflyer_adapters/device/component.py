"""Component through which the master uses one device.

Instant: a point in time at which the master steps components. A step of this component reads the
measurements of the device. At the end of each instant, the loop (`freeflyer_adapters.loop`) writes
the commands to the device.
"""

from __future__ import annotations

from freeflyer.fmi.component import PythonComponent
from freeflyer_adapters.device.device import Device


class DeviceComponent(PythonComponent):
    """Component of one device. The initialisation configures the device.

    `loop.hil` activates the device.
    """

    variable_step = False

    def __init__(self, device: Device) -> None:
        super().__init__(device.name, list(device.ports.values()), device.values)
        self.device = device

    def initialise(self, start: float) -> None:
        self.device.configure()

    def advance(self, time: float, size: float) -> None:
        self.device.read()

    def step(self, time: float, size: float) -> None:
        """Read the device once. `time` and `size` are in s; the device has its own clock."""
        self.advance(time, size)  # no further check: the device itself checks its measurements

    def close(self) -> None:
        """Deactivate the device."""
        self.device.deactivate()
