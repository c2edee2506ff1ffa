"""Interface of simulated, virtual and real devices: life cycle, call order and errors.

The loop calls `configure`, `check_start`, `prepare` and `activate` in this order. It then
calls `read` and `write` in every cycle, and finally `revoke`, `ramp_down` and `deactivate`. It may
call `on_error` at any time; the device is then in safe stop or fault. The option `--check` ends
after `check_start`. Up to this call, no message changes the state of the device. Both ends of a
link, the host and the device, follow `TRANSITIONS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from typing import Protocol

from freeflyer.fmi.component import Array, Port
from freeflyer.foundation.errors import CosimError, StepFailed
from freeflyer_adapters.foundation.histogram import Histogram


class LifeCycle(IntEnum):
    """Device states, as in ros2_control and KUKA's FRI.

    A new activation leaves safe stop. Only a reset leaves fault.
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
"""Suffix of the names of reported numbers that are life cycle states."""
SIMULATED = "simulated"
"""Kind of a device whose model runs in the host process."""


class DeviceError(CosimError):
    """Error of a device that cannot be configured or activated. Nothing has moved."""


class SafeStop(StepFailed):
    """Request for a stop: a violated limit, lost cycles, or a report of the device."""


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
    """True if `read` waits for the cycle of the device. The device then paces the loop."""
    state: State
    ports: Mapping[str, Port]
    """Settings (parameters), commands (inputs) and measurements (outputs), in SI units.

    The names state the frames.
    """
    values: dict[str, Array]
    """Arrays of the ports (`freeflyer.fmi.component.memory`). The master reads and writes them."""

    @property
    def woken(self) -> int:
        """Arrival time of the last measurement [ns, CLOCK_MONOTONIC]; 0 if not `is_clock`."""

    @property
    def step(self) -> float:
        """Period of the calls of `read` and `write` [s]."""

    @property
    def may_have_power(self) -> bool:
        """True after any message that may have given power, even if the activation failed."""

    @property
    def cannot_refuse(self) -> Sequence[str]:
        """Unsafe commands and faults that the device cannot reject or report, one sentence each.

        Valid after `configure`.
        """

    @property
    def remarks(self) -> Sequence[str]:
        """Remarks for the operator after a run, one sentence each."""

    def configure(self) -> None:
        """Open the link, compare the device with the scenario, and read the first measurement.

        Raises DeviceError if they differ, or if the device does not respond.
        """

    def check_start(self) -> None:
        """Check that the device may be activated now. Called for all devices before `prepare`.

        Raises DeviceError with the measured and the expected value.
        """

    def prepare(self) -> None:
        """Do the part of the activation that gives no power, for all devices before `activate`.

        Raises DeviceError if it fails.
        """

    def stay(self) -> None:
        """Keep the present state for one cycle, while another device is being activated."""

    def activate(self, meanwhile: Callable[[], bool]) -> None:
        """Activate without a bump: the first command equals the measurement.

        `meanwhile` is called in every cycle of the activation. It returns True if the user
        requested a stop. Raises DeviceError if the activation fails.
        """

    def read(self) -> None:
        """Read the latest measurements. Raises SafeStop for a limit or for lost cycles."""

    def write(self) -> None:
        """Send the commands within their limits. Raises SafeStop if they must not be sent."""

    def revoke(self, reason: str) -> None:
        """Revoke the power of this activation permanently; `reason` is the reason of the stop.

        From now on, only commands that lower the power are sent.
        """

    def ramp_down(self, elapsed: float) -> bool:
        """Run a cycle of the graded stop, `elapsed` [s] after its start. Return True at its end."""

    @property
    def at_rest(self) -> bool:
        """True if the device has confirmed that it is at rest and holds its position."""

    def on_error(self, reason: str) -> None:
        """Go from active to safe stop after a failure of the loop."""

    def deactivate(self) -> None:
        """Leave the device inactive and holding its position, and close the link.

        May be called in any state, and repeatedly.
        """

    def report(self) -> Mapping[str, float]:
        """Return the counters of the summary and the live view. Must be fast: the loop calls it."""

    def histograms(self) -> Mapping[str, Histogram]:
        """Return the histograms of the times that the device measures."""
