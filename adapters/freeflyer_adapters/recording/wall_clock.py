"""This machine's wall clock beside the monotonic one.

A recording's times are the monotonic clock's, with one offset that is read at the start of the run. NTP that slews changes the rate of
both clocks alike, so that their difference is constant until the wall clock is set; such a step is named, and changes no time.
"""

from __future__ import annotations

from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.environment import Environment

NAMED = 100_000_000
"""[ns] The smallest step that is named."""
MOST_NAMED = 100
"""A clock that is set all the time must not fill the result."""
READINGS = 3


def offset_of(clocks: Environment) -> int:
    """Wall clock minus monotonic clock [ns], of several readings the one that took least: a process may be held up in between."""
    readings = []
    for _ in range(READINGS):
        before, wall, after = clocks.monotonic_ns(), clocks.time_ns(), clocks.monotonic_ns()
        readings.append((after - before, wall - (before + after) // 2))
    return min(readings)[1]


def sentence(step: int, when: str) -> str:
    """`step` [ns], positive where the wall clock was set forward."""
    direction = "back" if step < 0 else "forward"
    size = f"{abs(step) * 1e-9:.3f} s"
    return f"this machine's clock was set {direction} by {size}, {when}; the recording's times go on from the clock at its start"


class WallClock:
    """`offset` [ns]: wall clock minus monotonic clock at the start; `started` [ns since the epoch]."""

    def __init__(self, offset: int, started: int) -> None:
        self.offset, self.started = offset, started
        self.steps: list[str] = []
        """A sentence for every step of `NAMED` or more that `look` has found."""
        self._environment = environment.present()
        self._known = 0

    @classmethod
    def start(cls) -> WallClock:
        """At the start of a run, which is now."""
        clocks = environment.present()
        offset = offset_of(clocks)
        return cls(offset, clocks.monotonic_ns() + offset)

    @property
    def is_the_machines(self) -> bool:
        """Virtual time is one process's own; another one, as the recorder, has other clocks."""
        return type(self._environment) is Environment

    def now(self) -> int:
        """As the recording's times have it [ns since the epoch]: no step changes it."""
        return self._environment.monotonic_ns() + self.offset

    def step(self) -> int:
        """By how much the wall clock has been set since the start [ns]; positive: forward."""
        return offset_of(self._environment) - self.offset

    def look(self) -> str | None:
        """The sentence about a step since the last look, if there was one."""
        step = self.step()
        new = step - self._known
        if abs(new) < NAMED:
            return None
        self._known = step
        if len(self.steps) > MOST_NAMED:
            return None
        after = f"{(self.now() - self.started) * 1e-9:.1f} s after the start"
        named = (
            sentence(new, after)
            if len(self.steps) < MOST_NAMED
            else "further steps of this machine's clock are not named"
        )
        self.steps.append(named)
        return named

    def whole_step(self) -> list[str]:
        """For a run in which nothing has looked: a sentence about start and end, if they differ by a step."""
        step = self.step()
        return [sentence(step, "some time during the run")] if abs(step) >= NAMED else []
