"""Permit: object that decides whether the host may send frames that give power to a device.

Every activation takes a new permit. A permit is lost permanently in these cases:

- There is a reason to stop.
- The loop is delayed for longer than the watchdog time of the device.
- The device has reported the state active, and then reports another state.

A lost permit cannot be taken again. Without a permit, the host sends only frames that lower the
power of the device.
"""

from __future__ import annotations


class Permit:
    """Decision logic of the permit. This class reads no clock and sends nothing.

    Times are [ns] of the monotonic clock. `subject`: name of the device in messages. `watchdog`
    [ns]: longest time for which the device continues without a command. After a longer delay of the
    loop, the device counts as stopped. `reports_state`: whether the device reports its life cycle
    state. If the device reports no state, the caller derives the state from measurements.
    """

    def __init__(self, subject: str, *, watchdog: int, reports_state: bool = True) -> None:
        self.subject, self.watchdog, self.reports_state = subject, watchdog, reports_state
        self.lost: str | None = None
        """Reason why the permit was lost, or None if it was not lost."""
        self._hold_up = ""
        self._is_taken = self._was_active = False
        self._wrote: int | None = None
        self._active_at: int | None = None

    @property
    def last_write(self) -> int:
        """Time when the loop last sent a frame or took the permit [ns].

        0: the permit was not taken yet.
        """
        return self._wrote or 0

    @property
    def is_held(self) -> bool:
        return self._is_taken and self.lost is None

    def take(self, now: int) -> None:
        """Take the permit for an activation. Raises RuntimeError if it was taken or lost before."""
        if self._is_taken or self.lost is not None:
            raise RuntimeError(
                f"{self.subject}: this permit was taken or lost before; a new activation needs a new permit"
            )
        self._is_taken, self._wrote = True, now
        self._was_active, self._active_at = False, None

    def lose(self, reason: str) -> None:
        """Revoke the permit permanently. Only the first reason is stored."""
        if self.lost is None:
            self.lost = reason

    def report(self, active: bool, at: int) -> None:
        """Process a state report of the device.

        `active`: whether the reported state is active. `at` [ns]: the report was not sent before
        this time. Reports that arrive before `take` are ignored.
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
        return self._is_taken and self.lost is None  # same as `is_held`, but faster

    @property
    def was_held_up(self) -> bool:
        return bool(self._hold_up)

    def hold_up(self, now: int) -> str:
        """Return the reason to stop if the loop was held up, or an empty string.

        Held up: the loop was delayed for longer than the watchdog time of the device. This reason
        takes precedence over all other reasons, because the delay of the loop causes the other
        reasons.
        """
        self.allows(now)
        return self._hold_up

    def wrote(self, now: int) -> None:
        """Record that the loop sent a frame. Detect a delay of the loop before this frame."""
        if self._wrote is not None:
            if now - self._wrote > self.watchdog:
                self.allows(now)
            self._wrote = now

    def may_ramp_down(self, now: int) -> bool:
        """Return whether the torques of a graded stop may be sent.

        The last report of the state active must not be older than the watchdog time. Without such a
        report, the device may have stopped, and a torque could activate the device again. If the
        device reports no state, the result is also False after a delay of the loop. The device may
        have stopped during this delay.
        """
        if self.hold_up(now) and not self.reports_state:
            return False
        return (
            self._is_taken
            and self._active_at is not None
            and now - self._active_at <= self.watchdog
        )
