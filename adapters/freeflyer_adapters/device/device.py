"""What simulated, virtual and real devices have in common: their life cycle, their calls, and how they fail.

Calls come in this order: `configure`, `check_start`, `prepare`, `activate`, then `read` and `write` in turn once a cycle, then `revoke` and
`ramp_down`, at last `deactivate`; `on_error` may come at any time and leaves the device in safe stop or fault. Up to `check_start`, which is
where `--check` ends, nothing is sent that changes the device. The states and what leads from one to another are those of
`TRANSITIONS`; both ends of a link (the host's device and the device itself) keep to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from typing import Protocol

from freeflyer.fmi.component import Array, Port
from freeflyer.foundation.errors import CosimError, StepFailed
from freeflyer_adapters.foundation.histogram import Histogram


class LifeCycle(IntEnum):
    """As ros2_control and KUKA's FRI have it, with safe stop apart from fault: one is left by activating anew, the other by reset."""

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
"""A reported number whose name ends so is a state of the life cycle."""
SIMULATED = "simulated"
"""The kind of a device that is its model in the host's own process."""


class DeviceError(CosimError):
    """A device that cannot be configured or activated; nothing has moved."""


class SafeStop(StepFailed):
    """A device, or who watches it, demands a stop: a limit, lost cycles, or the device's own word."""


class State:
    """A life cycle that refuses a step which `TRANSITIONS` does not have."""

    def __init__(self, subject: str) -> None:
        self.subject = subject
        self.now = LifeCycle.unconfigured

    def to(self, following: LifeCycle) -> None:
        if following == self.now:
            return
        if following not in TRANSITIONS[self.now]:
            raise RuntimeError(
                f"{self.subject}: {self.now.name} -> {following.name} is no transition of its life cycle"
            )
        self.now = following


class Device(Protocol):
    """One arm or base robot as the host sees it."""

    name: str
    is_clock: bool
    """Whether `read` waits for the device's own cycle, which then paces the loop."""
    state: State
    ports: Mapping[str, Port]
    """Parameters are settings, inputs are commands, outputs are measurements; all SI, in frames that their names say."""
    values: dict[str, Array]
    """`freeflyer.fmi.component.memory` of the ports; the master reads and writes these arrays."""

    @property
    def woken(self) -> int:
        """A clock: when its last measurement came [ns of CLOCK_MONOTONIC]; 0 for a device that is none."""

    @property
    def step(self) -> float:
        """How often `read` and `write` are called [s]."""

    @property
    def may_have_power(self) -> bool:
        """Whether anything was sent that may have given the device power, also where its activation was given up half-way."""

    @property
    def cannot_refuse(self) -> Sequence[str]:
        """What the device itself cannot refuse or report, a sentence for each; known once it is configured."""

    @property
    def remarks(self) -> Sequence[str]:
        """After a run: what else the operator should know of it, a sentence for each."""

    def configure(self) -> None:
        """Open the link, compare the device with what the scenario expects, read the first measurement.

        DeviceError if they do not agree, or nobody answers.
        """

    def check_start(self) -> None:
        """Whether the device may be activated now; asked of every device before any is. DeviceError, with both numbers."""

    def prepare(self) -> None:
        """The first half of an activation, of every device before any is active: whatever changes the device but gives no power.

        DeviceError if that cannot be done.
        """

    def stay(self) -> None:
        """Called in every cycle while another device takes its time to become active."""

    def activate(self, meanwhile: Callable[[], bool]) -> None:
        """Take over without a bump: the first command equals the measurement. DeviceError if that cannot be done.

        `meanwhile` is called in every cycle while that takes time; True means that the user wants to stop.
        """

    def read(self) -> None:
        """Fill the measurements with what is freshest; SafeStop if a limit or the quality monitor demands it."""

    def write(self) -> None:
        """Send the commands, within their limits; SafeStop if they must not be sent."""

    def revoke(self, reason: str) -> None:
        """The loop has a reason to stop: from now on only what lowers is sent. Nothing gives this activation's power back."""

    def ramp_down(self, elapsed: float) -> bool:
        """One cycle of the graded stop, `elapsed` [s] after its begin; True once there is nothing left to do for it."""

    @property
    def at_rest(self) -> bool:
        """Whether the device has confirmed that it stands and holds itself."""

    def on_error(self, reason: str) -> None:
        """The loop has failed: from active to safe stop."""

    def deactivate(self) -> None:
        """Leave the device inactive, holding itself, and close the link. May be called in any state, more than once."""

    def report(self) -> Mapping[str, float]:
        """Counters by name, for the summary and the live view; cheap, as the loop calls it."""

    def histograms(self) -> Mapping[str, Histogram]:
        """Times that the device measures, by name."""
