"""The host's end of a drive's state machine: which command the next controlword may have."""

from __future__ import annotations

from freeflyer_adapters.cia402.state_machine import TOWARDS_ENABLED, Command, DriveState
from freeflyer_adapters.device.permit import Permit


class DriveSession:
    """Decides only: no clock is read and nothing is sent. Times are [ns] of the monotonic clock. All drives of an arm share one permit.

    Each step towards Operation enabled answers the statusword of the step before. A fault is never reset by a cyclic
    frame.
    """

    def __init__(self, permit: Permit, subject: str) -> None:
        self.permit, self.subject = permit, subject
        self.state: DriveState | None = None
        self._was_enabled = False

    def report(self, state: DriveState | None) -> None:
        """A statusword."""
        self.state = state
        if state is DriveState.operation_enabled:
            self._was_enabled = True
        elif self._was_enabled:
            self.permit.lose(f"{self.subject} left Operation enabled by itself")

    def answer(self, now: int, *, brake: bool = False) -> Command:
        """The command of the next controlword; `brake`: the graded stop has come to its end."""
        if not brake:
            if self.permit.allows(now):
                if self.state is None:
                    return Command.disable_voltage
                return TOWARDS_ENABLED.get(self.state, Command.disable_voltage)
            # The graded stop: torque that falls, of drives that are all known to be enabled.
            if self.permit.may_ramp_down(now) and self.state is DriveState.operation_enabled:
                return Command.enable_operation
        # From Operation enabled a drive ramps down by itself and switches off; elsewhere this switches off.
        return Command.quick_stop if self._was_enabled else Command.disable_voltage
