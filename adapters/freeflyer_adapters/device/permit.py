"""Permit: the interlock on the host between a run and the power of a device.

Every activation takes a new permit. The permit is lost at the first reason to stop, after a delay
of the loop longer than the device's watchdog, and when the device reports a state other than
active. A lost permit cannot be taken again. Without a permit, only frames that lower the power of
the device are sent.
"""

from __future__ import annotations


class Permit:
    """Decision logic of the permit: reads no clock and sends nothing.

    Times are [ns] of the monotonic clock. `watchdog` [ns] is the time that the device continues
    without a command. After a longer delay of the loop, the device counts as stopped.
    `reports_state`: whether the device reports its life cycle state. If it does not, every
    measurement counts as a report of the state active.
    """

    def __init__(self, subject: str, *, watchdog: int, reports_state: bool = True) -> None:
        self.subject, self.watchdog, self.reports_state = subject, watchdog, reports_state
        self.lost: str | None = None
        """Reason of the loss; None before it."""
        self._hold_up = ""
        self._is_taken = self._was_active = False
        self._wrote: int | None = None
        self._active_at: int | None = None

    @property
    def last_write(self) -> int:
        """Time when the loop last sent a frame or took the permit [ns]; 0 before."""
        return self._wrote or 0

    @property
    def is_held(self) -> bool:
        return self._is_taken and self.lost is None

    def take(self, now: int) -> None:
        """Take the permit for an activation. Raises RuntimeError if it was taken or lost before."""
        if self._is_taken or self.lost is not None:
            raise RuntimeError(f"{self.subject}: a permit is taken once")
        self._is_taken, self._wrote = True, now
        self._was_active, self._active_at = False, None

    def lose(self, reason: str) -> None:
        """Revoke the permit permanently. Only the first reason is stored."""
        if self.lost is None:
            self.lost = reason

    def report(self, active: bool, at: int) -> None:
        """Process a state report that the device sent at `at` or later [ns].

        Reports before the permit is taken are ignored.
        """
        if not self._is_taken:
            return
        if active:
            self._was_active, self._active_at = True, at
            return
        self._active_at = None
        if self._was_active:
            self.lose(f"{self.subject} reported another state than active")

    def allows(self, now: int) -> bool:
        """Return whether a command that gives power may be sent now."""
        if self._wrote is not None and now - self._wrote > self.watchdog:
            self._hold_up = self._hold_up or (
                f"the loop was held up for {(now - self._wrote) * 1e-9:.3g} s, longer than the watchdog of {self.subject} "
                f"({self.watchdog * 1e-9:g} s); the device has stopped"
            )
            self.lose(self._hold_up)
        return self._is_taken and self.lost is None  # `is_held` without a call: hot path

    @property
    def was_held_up(self) -> bool:
        return bool(self._hold_up)

    def hold_up(self, now: int) -> str:
        """Return the reason to stop if the loop was held up, else an empty string.

        This reason takes precedence over every other: the delay is the cause.
        """
        self.allows(now)
        return self._hold_up

    def wrote(self, now: int) -> None:
        """Record that the loop sent a frame. A delay before this frame is still detected."""
        if self._wrote is not None:
            if now - self._wrote > self.watchdog:
                self.allows(now)
            self._wrote = now

    def may_ramp_down(self, now: int) -> bool:
        """Return whether the device is still active, from reports within its watchdog time.

        Otherwise the torques of a graded stop could activate it again.
        """
        if self.hold_up(now) and not self.reports_state:
            return False
        return (
            self._is_taken
            and self._active_at is not None
            and now - self._active_at <= self.watchdog
        )
