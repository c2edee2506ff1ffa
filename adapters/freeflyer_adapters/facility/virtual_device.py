"""Interface of virtual devices.

A virtual device is connected to a model of a robot. For the controllers, it is the device at the
other end of a link.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from freeflyer.fmi.component import Array, Port
from freeflyer_adapters.facility.link_faults import LinkFaults
from freeflyer_adapters.foundation.histogram import Histogram


class Logic(Protocol):
    """State machine of a virtual device."""

    events: list[tuple[int, str]]
    """Cycle and text of each event."""
    was_active: bool

    @property
    def session_is_over(self) -> bool: ...


def arm_ports(joints: int) -> tuple[tuple[Port, ...], tuple[Port, ...]]:
    """Return the ports that connect a virtual arm to its model: commands, then measurements."""
    brake = Port(name="brake", size=1, causality="output", units=("1",), sampled=True, start=(1.0,))
    torque = Port(
        name="joint_torque_command",
        size=joints,
        causality="output",
        units=("N.m",) * joints,
        sampled=True,
    )
    units = {"joint_position": "rad", "joint_velocity": "rad/s", "joint_torque": "N.m"}
    measurements = (
        Port(name=name, size=joints, causality="input", units=(unit,) * joints)
        for name, unit in units.items()
    )
    return (torque, brake), tuple(measurements)


class LinkEnd(Protocol):
    silent: bool
    """Whether the device neither sends nor receives."""


L = TypeVar("L", bound=Logic)


class VirtualDevice(ABC, Generic[L]):
    """A virtual device.

    The facility calls `begin_session` at the start of a session. Then, in every cycle, the facility
    calls `receive`, steps the model, and calls `send`.
    """

    name: str
    fault_kinds: ClassVar[tuple[str, ...]] = ()
    """Kinds in `freeflyer_adapters.facility.faults.KINDS` that the device supports."""
    logic: L
    commands: tuple[Port, ...]
    """Ports of the received values. They are connected to inputs of the model."""
    measurements: tuple[Port, ...]
    """Ports of the sent values. They are connected to outputs of the model."""

    # Faults of the whole device

    def begin_faults(self, faults: LinkFaults[Any], end: LinkEnd) -> None:
        """Deactivate all faults for a new session. `end` is the device end of the link."""
        self._faults, self._end = faults, end
        self._cycles = 0
        self._active_since: int | None = None
        faults.reset()
        end.silent = False

    def begin_cycle(self) -> bool:
        """Apply the faults of the whole device. Call this method first in every cycle.

        Return whether the state machine of the device runs in this cycle.
        """
        faults = self._faults
        self._cycles += 1
        if self._active_since is None and self.logic.was_active:
            self._active_since = self._cycles
        faults.begin_cycle(
            None if self._active_since is None else self._cycles - self._active_since
        )
        dead, hung = faults.acts("dead"), faults.acts("hung")
        if dead:
            self.power_off()
        elif faults.acts("device_fault"):
            self.fail()
        self._end.silent = dead or hung
        return not hung

    def power_off(self) -> None:
        """Remove the power, so that only the brakes act."""

    def fail(self) -> None:
        """Cause a fault of the device itself."""

    @abstractmethod
    def begin_session(self, parameters: Mapping[str, Array]) -> None:
        """Start a session with the robots at their start poses.

        `parameters`: parameters of the model.
        """

    @abstractmethod
    def receive(self, values: Mapping[str, Array]) -> None:
        """Write the `commands` for this cycle into `values`, which has one array per port name."""

    @abstractmethod
    def send(self, values: Mapping[str, Array]) -> None:
        """Send the `measurements` in `values`, which has one array per port name."""

    @abstractmethod
    def report(self) -> Mapping[str, float]:
        """Return counters by name."""

    def histograms(self) -> Mapping[str, Histogram]:
        """Return histograms of times by name."""
        return {}

    @abstractmethod
    def close(self) -> None:
        """Close the link."""

    @property
    def events(self) -> list[tuple[int, str]]:
        """Events of the session: the cycle, and a sentence."""
        return self.logic.events

    @property
    def session_is_over(self) -> bool:
        """Whether the controller has ended the session."""
        return self.logic.session_is_over

    @property
    def is_idle(self) -> bool:
        """Whether the device has not been active in this session."""
        return not self.logic.was_active
