"""Interface of simulated, virtual and real devices: life cycle, call order and errors.

The loop calls the methods of a device in this order:

1. `configure`, `check_start`, `prepare` and `activate`.
2. `read` and `write` in every cycle.
3. `revoke`, `ramp_down` and `deactivate`.

The loop may call `on_error` at any time. `on_error` changes an active device to the state
safe_stop. With the option `--check`, the run ends after `check_start`. Until the end of
`check_start`, the host sends no message that changes the state of the device. The host and the
device both follow `TRANSITIONS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from typing import Protocol

from freeflyer.fmi.component import Array, Port
from freeflyer.foundation.errors import StepFailed
from freeflyer_adapters.foundation.histogram import Histogram


class LifeCycle(IntEnum):
    """Life cycle states of a device, as in ros2_control and KUKA's FRI.

    A new activation ends the state safe_stop. Only a reset ends the state fault.
    """

    unconfigured = 0
    inactive = 1
    active = 2
    safe_stop = 3
    fault = 4


TRANSITIONS: Mapping[LifeCycle, frozenset[LifeCycle]] = {
    LifeCycle.unconfigured: frozenset({LifeCycle.inactive, LifeCycle.fault}),
    LifeCycle.inactive: frozenset({LifeCycle.active, LifeCycle.unconfigured, LifeCycle.fault}),
    LifeCycle.active: frozenset({LifeCycle.inactive, LifeCycle.safe_stop, LifeCycle.fault}),
    LifeCycle.safe_stop: frozenset({LifeCycle.inactive, LifeCycle.unconfigured, LifeCycle.fault}),
    LifeCycle.fault: frozenset({LifeCycle.unconfigured, LifeCycle.inactive}),
}


STATE = ": state"
"""Suffix of a name in the live view. The value of such a name is a life cycle state."""
SIMULATED = "simulated"
"""Kind of a device whose model runs in the host process."""


class SafeStop(StepFailed):
    """Request for a stop.

    Possible reasons are a violated limit, lost cycles, or a report of the device.
    """


class State:
    """Life cycle state of one device."""

    def __init__(self, subject: str) -> None:
        self.subject = subject
        self.now = LifeCycle.unconfigured

    def to(self, following: LifeCycle) -> None:
        """Change the state. Raises RuntimeError for a transition that is not in `TRANSITIONS`."""
        if following == self.now:
            return
        if following not in TRANSITIONS[self.now]:
            raise RuntimeError(
                f"{self.subject}: {self.now.name} -> {following.name} is not a transition of its life cycle"
            )
        self.now = following


class Device(Protocol):
    """Host side of one arm or base robot."""

    name: str
    is_clock: bool
    """True if `read` waits for the next cycle of the device.

    The device is then the clock of the loop.
    """
    state: State
    ports: Mapping[str, Port]
    """Settings (parameters), commands (inputs) and measurements (outputs), in SI units.

    The name of a port states the coordinate frame of its values.
    """
    values: dict[str, Array]
    """Arrays of the ports (`freeflyer.fmi.component.memory`). The master reads and writes them."""

    @property
    def woken(self) -> int:
        """Arrival time of the last measurement [ns, CLOCK_MONOTONIC]; 0 if `is_clock` is False."""

    @property
    def step(self) -> float:
        """Period of the calls of `read` and `write` [s]."""

    @property
    def may_have_power(self) -> bool:
        """True after a message that may have given power to the device.

        The value stays True if the activation fails after this message.
        """

    @property
    def cannot_refuse(self) -> Sequence[str]:
        """Sentences about unsafe commands and faults that the device cannot reject or report.

        The sentences are valid after `configure`.
        """

    @property
    def remarks(self) -> Sequence[str]:
        """Sentences for the operator after a run."""

    def configure(self) -> None:
        """Open the link, compare the device with the scenario, and read the first measurement.

        Raises DeviceError if the device differs from the scenario, or if it does not respond.
        """

    def check_start(self) -> None:
        """Check that the device may be activated now.

        The loop calls this method for all devices before it calls `prepare` for the first device.
        Raises DeviceError if the device must not be activated. The message contains the measured
        value and the expected value.
        """

    def prepare(self) -> None:
        """Do the part of the activation that gives no power to the device.

        The loop calls this method for all devices before it calls `activate` for the first device.
        Raises DeviceError if this part fails.
        """

    def stay(self) -> None:
        """Keep the present state for one cycle, while another device is being activated."""

    def activate(self, meanwhile: Callable[[], bool]) -> None:
        """Activate the device without a jump. The first command equals the measurement.

        `meanwhile` is called in every cycle of the activation. It returns True if the user
        requested a stop. Raises DeviceError if the activation fails.
        """

    def read(self) -> None:
        """Read the latest measurements.

        Raises SafeStop if a measurement violates a limit, or if too many cycles were lost.
        """

    def write(self) -> None:
        """Limit and send the commands. Raises SafeStop if the commands must not be sent."""

    def revoke(self, reason: str) -> None:
        """Permanently revoke the permission to give power to the device in this activation.

        `reason`: reason of the stop. From now on, only commands that lower the power are sent.
        """

    def ramp_down(self, elapsed: float) -> bool:
        """Run one cycle of the graded stop. Return True at the end of the graded stop.

        Graded stop: the commands bring the device to rest, then the device holds its position.
        `elapsed` [s]: time since the start of the graded stop.
        """

    @property
    def at_rest(self) -> bool:
        """True if the device has confirmed that it is at rest and holds its position."""

    def on_error(self, reason: str) -> None:
        """Change from the state active to the state safe_stop after a failure of the loop."""

    def deactivate(self) -> None:
        """Change to the state inactive, and close the link. The device holds its position.

        This method may be called in any state, and more than once.
        """

    def report(self) -> Mapping[str, float]:
        """Return the counters for the summary and the live view.

        This method must be fast, because the loop calls it.
        """

    def histograms(self) -> Mapping[str, Histogram]:
        """Return the histograms of the times that the device measures."""
