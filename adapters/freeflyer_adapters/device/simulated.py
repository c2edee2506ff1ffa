"""Device that is simulated by a model in the host process (`kind = "simulated"`).

The wall clock sets the cycles of the loop. A model is treated as an arm if it has the ports
`joint_torque_command` and `joint_velocity`. Such a model is braked until its activation. It has the
limits of an arm, and is brought to rest like a real arm. A model is treated as a base if it has the
port `position_setpoint` and the other ports of a base. Such a model has the limits of a base. All
models start at the start values of the scenario. Therefore `check_start` has nothing to compare.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from freeflyer.fmi.component import Array, Component, Port, memory
from freeflyer.fmi.fmu import FmuComponent
from freeflyer.foundation.keys import declares, read
from freeflyer.scenario.assemble import FMU, find_fmu
from freeflyer.scenario.keys import COMPONENT
from freeflyer_adapters.device import parameters as device_parameters
from freeflyer_adapters.device.component import DeviceComponent
from freeflyer_adapters.device.device import LifeCycle, SafeStop, State
from freeflyer_adapters.device.limits import ArmLimits, BaseLimits
from freeflyer_adapters.device.ramp_down import RampDown
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.foundation.histogram import Histogram


class SimulatedDevice:
    """Simulated device. Implements `freeflyer_adapters.device.device.Device`.

    Each call of `read` executes one step of `model`.
    """

    is_clock = False

    def __init__(self, name: str, model: Component) -> None:
        self.name, self.model = name, model
        self.state = State(name)
        self.is_arm = {"joint_torque_command", "joint_velocity"} <= model.ports.keys()
        self.is_base = {
            "position_setpoint",
            "orientation_setpoint",
            "velocity_setpoint",
            "base_position",
        } <= model.ports.keys()
        ports = {
            port.name: replace(port, sampled=port.causality == "output")
            for port in model.ports.values()
            if port.real
        }
        self._parameters = [port.name for port in ports.values() if port.settable]
        if self.is_arm:
            joints = model.ports["joint_torque_command"].size
            for port in device_parameters.ports(device_parameters.ARM, joints):
                ports.setdefault(port.name, port)
        if self.is_base:
            for port in device_parameters.ports(device_parameters.BASE):
                ports.setdefault(port.name, port)
        self._sent: tuple[Array, Array] | None = None
        self._inputs = [port.name for port in ports.values() if port.causality == "input"]
        self._outputs = [port.name for port in ports.values() if port.causality == "output"]
        self.ports: Mapping[str, Port] = ports
        self.values = memory(self.ports.values())
        self._count = 0
        self._last_torque = (
            np.zeros(ports["joint_torque_command"].size) if self.is_arm else np.zeros(0)
        )
        self._stopping: Array | None = None

    @property
    def step(self) -> float:
        return float(self.values["period"][0])

    @property
    def woken(self) -> int:
        return 0

    def configure(self) -> None:
        if self.is_arm:
            device_parameters.check(self.name, device_parameters.ARM, self.values)
        if self.is_base:
            device_parameters.check(self.name, device_parameters.BASE, self.values)
        given = {name: self.values[name].copy() for name in self._parameters}
        self.model.enter_initialization(0.0, given)
        inputs = np.concatenate([np.zeros(0), *(self.values[name] for name in self._inputs)])
        outputs = np.concatenate([np.zeros(0), *(self.values[name] for name in self._outputs)])
        self._input_buffer, self._output_buffer = inputs, outputs
        self._write = self.model.bind_inputs(self._inputs, inputs) if self._inputs else _nothing
        self._read = self.model.bind_outputs(self._outputs, outputs) if self._outputs else _nothing
        self._brake(True)
        self._write_inputs()
        self.model.exit_initialization()
        self._read_outputs()
        v = self.values
        if self.is_base:
            self.base_limits = BaseLimits(v)
        if self.is_arm:
            self.limits = ArmLimits(v, self.step)
            self.ramp = RampDown.of(v)
        self.state.to(LifeCycle.inactive)

    def check_start(self) -> None:
        pass

    cannot_refuse = remarks = ()
    may_have_power = False
    """Always False, because a model has no actuator.

    A simulated device needs no permit, because no frame can give power to it.
    """

    def prepare(self) -> None:
        pass

    def stay(self) -> None:
        pass

    def revoke(self, reason: str) -> None:
        pass

    def activate(self, meanwhile: Callable[[], bool]) -> None:
        self.state.to(LifeCycle.active)
        self._brake(False)
        self._last_torque[:] = 0.0

    def read(self) -> None:
        self._cycle()
        if self.is_arm and self.state.now is LifeCycle.active:
            reason = self.limits.measured(
                self.values["joint_position"], self.values["joint_velocity"]
            )
            if reason:
                raise SafeStop(self.name, reason)

    def write(self) -> None:
        if self.is_base:
            self._write_base()
        if not self.is_arm:
            return
        torque, reason = self.limits.command(self.values["joint_torque_command"], self._last_torque)
        if reason:
            raise SafeStop(self.name, reason)
        self._last_torque = torque

    def _write_base(self) -> None:
        """Check the set point and the measured pose once in each cycle of the set points."""
        v = self.values
        if self._count % max(1, round(float(v["cycle"][0]) / self.step)):
            return
        position, orientation = v["position_setpoint"], v["orientation_setpoint"]
        reason = self.base_limits.setpoint(
            position, orientation, v["velocity_setpoint"], self._sent
        )
        self._sent = (position.copy(), orientation.copy())
        reason = reason or self.base_limits.measured(
            v["base_position"], v["base_orientation"], self._sent
        )
        if reason:
            raise SafeStop(self.name, reason)

    def ramp_down(self, elapsed: float) -> bool:
        if not self.is_arm:
            self._cycle()
            return True
        if self._stopping is None:
            self._stopping = self._last_torque.copy()
        velocity = self.values["joint_velocity"]
        if self.ramp.over(velocity, elapsed):
            self._brake(True)
            self._last_torque = np.zeros_like(velocity)
            self._cycle()
            return True
        wanted = self.ramp.torque(self._stopping, velocity, elapsed)
        self._last_torque, _ = self.limits.command(wanted, self._last_torque)
        self._cycle()
        return False

    @property
    def at_rest(self) -> bool:
        return not self.is_arm or "brake" not in self.values or bool(self.values["brake"][0])

    def on_error(self, reason: str) -> None:
        self._brake(True)
        if self.state.now is LifeCycle.active:
            self.state.to(LifeCycle.safe_stop)

    def deactivate(self) -> None:
        self._brake(True)
        if self.state.now in (LifeCycle.active, LifeCycle.safe_stop):
            self.state.to(LifeCycle.inactive)
        self.model.close()

    def report(self) -> Mapping[str, float]:
        return self.limits.report() if self.is_arm else {}

    def histograms(self) -> Mapping[str, Histogram]:
        return {}

    # The model

    def _brake(self, engaged: bool) -> None:
        if "brake" in self.values:
            self.values["brake"][0] = float(engaged)

    def _cycle(self) -> None:
        self._write_inputs()
        self.model.step(self._count * self.step, self.step)
        self._count += 1
        self._read_outputs()

    def _write_inputs(self) -> None:
        first = 0
        for name in self._inputs:
            # An arm gets the torque that `write` has limited, not the command of the controller.
            value = (
                self._last_torque
                if self.is_arm and name == "joint_torque_command"
                else self.values[name]
            )
            self._input_buffer[first : first + value.size] = value
            first += value.size
        self._write()

    def _read_outputs(self) -> None:
        self._read()
        first = 0
        for name in self._outputs:
            value = self.values[name]
            value[:] = self._output_buffer[first : first + value.size]
            first += value.size


def _nothing() -> None:
    pass


@declares(FMU)
def simulated_component(name: str, options: Mapping[str, Any], directory: Path) -> DeviceComponent:
    """Return a device of the kind "simulated". This function is an entry point.

    The keys `fmu` and `fmi` have the same meaning as for a component of the kind "fmu". Raises
    DeviceError if the FMU has no settable parameter `period`.
    """
    read(options, FMU, DeviceError, f"device {name}: ", others=COMPONENT)
    model = FmuComponent(name, find_fmu(name, options, directory))
    period = model.ports.get("period")
    if period is None or period.size != 1 or not period.settable:
        model.close()
        raise DeviceError(
            f"device {name}: {model.path} has no settable parameter period; a simulated device must be a sampled block"
        )
    return DeviceComponent(SimulatedDevice(name, model))
