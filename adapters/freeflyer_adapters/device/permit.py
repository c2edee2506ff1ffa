"""The permit: the host's lock between a run and a device's power.

An activation takes it, once. It is lost for good at the first reason to stop, when the loop was held up for longer than the device's
own watchdog, and when the device reports another state than active. Without it only frames that lower the device's power are sent.
"""

from __future__ import annotations


class Permit:
    """Decides only: no clock is read and nothing is sent. Times are [ns] of the monotonic clock.

    `watchdog` [ns]: how long the device goes on without a command; after a longer hold-up it must be taken to have stopped.
    `reports_state`: whether the device reports its life cycle. One that does not is taken to be active with every measurement.
    """

    def __init__(self, subject: str, *, watchdog: int, reports_state: bool = True) -> None:
        self.subject, self.watchdog, self.reports_state = subject, watchdog, reports_state
        self.lost: str | None = None
        """Why it was lost."""
        self._hold_up = ""
        self._is_taken = self._was_active = False
        self._wrote: int | None = None
        self._active_at: int | None = None

    @property
    def last_write(self) -> int:
        """When a frame of the loop's own was sent last, or the permit was taken [ns]; 0 before."""
        return self._wrote or 0

    @property
    def is_held(self) -> bool:
        return self._is_taken and self.lost is None

    def take(self, now: int) -> None:
        """Begin an activation. RuntimeError for a second one: every activation has a permit of its own."""
        if self._is_taken or self.lost is not None:
            raise RuntimeError(f"{self.subject}: a permit is taken once")
        self._is_taken, self._wrote = True, now
        self._was_active, self._active_at = False, None

    def lose(self, reason: str) -> None:
        """The first reason stays."""
        if self.lost is None:
            self.lost = reason

    def report(self, active: bool, at: int) -> None:
        """A report of the device's state, which was made at `at` or later; before the permit is taken, it counts for nothing."""
        if not self._is_taken:
            return
        if active:
            self._was_active, self._active_at = True, at
            return
        self._active_at = None
        if self._was_active:
            self.lose(f"{self.subject} reported another state than active")

    def allows(self, now: int) -> bool:
        """Whether a command that gives power may be sent now."""
        if self._wrote is not None and now - self._wrote > self.watchdog:
            self._hold_up = self._hold_up or (
                f"the loop was held up for {(now - self._wrote) * 1e-9:.3g} s, longer than the watchdog of {self.subject} "
                f"({self.watchdog * 1e-9:g} s), which has stopped by then"
            )
            self.lose(self._hold_up)
        return self._is_taken and self.lost is None  # as `is_held`, for the hot path without a call

    @property
    def was_held_up(self) -> bool:
        return bool(self._hold_up)

    def hold_up(self, now: int) -> str:
        """That the loop was held up, in a sentence, or "". It is the cause, whatever was noticed before it."""
        self.allows(now)
        return self._hold_up

    def wrote(self, now: int) -> None:
        """A frame of the loop's own was sent. One that went out after too long a gap does not hide it."""
        if self._wrote is not None:
            if now - self._wrote > self.watchdog:
                self.allows(now)
            self._wrote = now

    def may_ramp_down(self, now: int) -> bool:
        """Whether the device is known to be active still, so that the torques of a graded stop cannot activate it anew."""
        if self.hold_up(now) and not self.reports_state:
            return False
        return (
            self._is_taken
            and self._active_at is not None
            and now - self._active_at <= self.watchdog
        )
