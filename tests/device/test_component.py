"""A device of another package, through the public names alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

import freeflyer
import freeflyer_adapters


class Thermometer:
    """The part of `freeflyer_adapters.Device` that the master needs."""

    name = "thermometer"

    def __init__(self) -> None:
        self.ports: Mapping[str, freeflyer.Port] = {
            "offset": freeflyer.Port(
                name="offset",
                size=1,
                causality="parameter",
                units=("K",),
                start=(1.5,),
                settable=True,
            ),
            "temperature": freeflyer.Port(
                name="temperature", size=1, causality="output", units=("K",)
            ),
        }
        self.values = freeflyer.memory(self.ports.values())

    def configure(self) -> None:
        self.read()

    def read(self) -> None:
        self.values["temperature"][:] = 20.0 + self.values["offset"]

    def deactivate(self) -> None:
        pass


def test_a_device_of_another_package_shares_its_memory_with_the_master() -> None:
    device = Thermometer()
    component = freeflyer_adapters.DeviceComponent(device)  # type: ignore[arg-type]
    output = np.zeros(1)
    read = component.bind_outputs(["temperature"], output)
    component.enter_initialization(0.0, {"offset": np.array([2.0])})
    component.exit_initialization()
    read()
    assert output == [22.0]
    device.values["offset"] = np.array([3.0])  # copied into the same array
    component.step(0.0, 1.0)
    read()
    assert output == [23.0]
    component.close()
