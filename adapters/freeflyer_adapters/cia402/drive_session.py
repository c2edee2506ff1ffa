"""Session of the host with a drive. The session determines the command of the next controlword."""

from __future__ import annotations

from freeflyer_adapters.cia402.state_machine import TOWARDS_ENABLED, Command, DriveState
from freeflyer_adapters.device.permit import Permit


class DriveSession:
    """Decision logic of a session. This class reads no clock and sends nothing.

    All drives of an arm share one permit. The permit decides whether the host may send commands
    that give power. Times are [ns] of the monotonic clock. On the way to the state Operation
    enabled, the state in the last statusword of the drive determines the next command. No command
    of a session resets a fault. `subject`: name of the drive in messages.
    """

    def __init__(self, permit: Permit, subject: str) -> None:
        self.permit, self.subject = permit, subject
        self.state: DriveState | None = None
        self._was_enabled = False

    def report(self, state: DriveState | None) -> None:
        """Process the state in a received statusword.

        `state` is None if the statusword contains no defined state.
        """
        self.state = state
        if state is DriveState.operation_enabled:
            self._was_enabled = True
        elif self._was_enabled:
            self.permit.lose(f"{self.subject} left the state Operation enabled by itself")

    def answer(self, now: int, *, brake: bool = False) -> Command:
        """Return the command of the next controlword.

        `brake`: whether the drive must now stop by itself, without torque commands of the host.
        """
        if not brake:
            if self.permit.allows(now):
                if self.state is None:
                    return Command.disable_voltage
                return TOWARDS_ENABLED.get(self.state, Command.disable_voltage)
            # Graded stop: the host sends decreasing torques while recent statuswords report all
            # drives as enabled.
            if self.permit.may_ramp_down(now) and self.state is DriveState.operation_enabled:
                return Command.enable_operation
        # After a quick stop command, an enabled drive ramps down by itself, then disables power. A
        # drive that was never enabled disables power immediately.
        return Command.quick_stop if self._was_enabled else Command.disable_voltage
