"""A CAN log's times, on the time scale of the recording beside it.

The kernel stamps a frame with the wall clock of its arrival. By how much that has been set since the start is known at every look at
the bus, and frames come between two looks; so a frame near a step is before it or after it, whichever goes on from the frames
before, and is not in the future.
"""

from __future__ import annotations

from collections.abc import Sequence

import can

from freeflyer_adapters.recording.wall_clock import WallClock

STAMPED_BY_THE_WALL_CLOCK = ("local", "socketcan")
"""Interfaces whose stamps are the kernel's CLOCK_REALTIME. The others' stamps have epochs of their own."""
FOLLOWED = 5_000_000
"""[ns] A smaller difference may come from the reading of the clocks, and leaves stamps as they are."""


class FrameTimes:
    """To be made before the bus is opened."""

    def __init__(self, clock: WallClock) -> None:
        self._clock = clock
        self._steps = [_followed(clock.step(), 0)]
        """[ns] What the wall clock may have been set by when the frames to come were stamped."""
        self._last = self._from = clock.now() * 1e-9

    def put_right(self, frames: Sequence[can.Message], is_all: bool) -> list[can.Message]:
        """The frames in the order of their times, which are changed to those of the recording.

        `frames`: what has come since the last call, in the order in which it came; `is_all`: nothing is left on the bus.
        """
        self._steps.append(_followed(self._clock.step(), self._steps[-1]))
        now = self._clock.now() * 1e-9
        latest = self._from
        for frame in frames:
            frame.timestamp = latest = self._time(frame.timestamp, latest, now)
        if is_all:
            # The step before is kept: a frame may have come between the last look at the bus and that at the clock.
            del self._steps[:-2]
            self._from = now
        # Several senders of a `local` channel are read in turn, not in the order of their frames.
        ordered = sorted(frames, key=lambda frame: frame.timestamp)
        for frame in ordered:
            frame.timestamp = self._last = max(frame.timestamp, self._last)
        return ordered

    def _time(self, stamp: float, latest: float, now: float) -> float:
        """[s] `latest`: of the frame before."""
        slack = FOLLOWED * 1e-9
        possible = [
            time
            for time in sorted({stamp - step * 1e-9 for step in self._steps})
            if time <= now + slack
        ]
        if not possible:
            return now
        return next((time for time in possible if time >= latest - slack), possible[-1])


def _followed(step: int, before: int) -> int:
    """[ns]"""
    return step if abs(step - before) >= FOLLOWED else before
