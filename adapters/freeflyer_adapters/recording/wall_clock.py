"""Detection of steps of the wall clock during a recording.

The times of a recording are the times of the monotonic clock plus an offset. The offset is measured
at the start of the run. It is the difference of the wall clock and the monotonic clock. When NTP
changes the rate of the wall clock, the rate of the monotonic clock changes equally. Therefore the
difference is constant until the wall clock is set to another time. Such a change is a step. Steps
are reported. They do not change the times of the recording.
"""

from __future__ import annotations

from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.environment import Environment

SMALLEST_REPORTED = 100_000_000
"""Smallest step that is reported [ns]."""
MOST_REPORTED = 100
"""Maximum number of reported steps, so that the result stays small if there are many steps."""
READINGS = 3


def offset_of(clocks: Environment) -> int:
    """Return wall clock minus monotonic clock [ns].

    The clocks are read several times, and the fastest reading is used. In a slow reading, the
    process may have been suspended after it read one clock and before it read the other.
    """
    readings = []
    for _ in range(READINGS):
        before, wall, after = clocks.monotonic_ns(), clocks.time_ns(), clocks.monotonic_ns()
        readings.append((after - before, wall - (before + after) // 2))
    return min(readings)[1]


def sentence(step: int, when: str) -> str:
    """Return the message about a step of the wall clock.

    `step` [ns] is positive if the wall clock was set forward. `when` is the time of the step, as a
    text.
    """
    direction = "back" if step < 0 else "forward"
    size = f"{abs(step) * 1e-9:.3f} s"
    return f"this machine's clock was set {direction} by {size}, {when}; the times in the recording do not contain this step"


class WallClock:
    """Monitor of the wall clock.

    `offset` [ns]: wall clock minus monotonic clock at the start. `started`: start of the run [ns
    since the epoch].
    """

    def __init__(self, offset: int, started: int) -> None:
        self.offset, self.started = offset, started
        self.steps: list[str] = []
        """Messages that `check` has returned."""
        self._environment = environment.present()
        self._known = 0

    @classmethod
    def start(cls) -> WallClock:
        """Return a monitor for a run that starts now."""
        clocks = environment.present()
        offset = offset_of(clocks)
        return cls(offset, clocks.monotonic_ns() + offset)

    @property
    def is_system_clock(self) -> bool:
        """Whether the clocks are the clocks of the system. False in virtual time."""
        return type(self._environment) is Environment

    def now(self) -> int:
        """Return the time of the recording [ns since the epoch]. This time has no steps."""
        return self._environment.monotonic_ns() + self.offset

    def step(self) -> int:
        """Return the total step since the start [ns]. It is positive after a step forward."""
        return offset_of(self._environment) - self.offset

    def check(self) -> str | None:
        """Return a message if the wall clock was set since the last call, else None."""
        step = self.step()
        new = step - self._known
        if abs(new) < SMALLEST_REPORTED:
            return None
        self._known = step
        if len(self.steps) > MOST_REPORTED:
            return None
        after = f"{(self.now() - self.started) * 1e-9:.1f} s after the start"
        message = (
            sentence(new, after)
            if len(self.steps) < MOST_REPORTED
            else "further steps of this machine's clock are not reported"
        )
        self.steps.append(message)
        return message

    def total_step(self) -> list[str]:
        """Return a message about the total step. Return an empty list if there was no step.

        Use this method for a run in which `check` was never called.
        """
        step = self.step()
        is_reported = abs(step) >= SMALLEST_REPORTED
        return [sentence(step, "some time during the run")] if is_reported else []
