"""Conversion of frame times in a CAN log to the time scale of the recording.

The kernel stamps a frame with the wall clock at its arrival. The step of the wall clock since the
start is measured when the bus is read, but frames arrive between two readings. A frame near a step
may be stamped before or after it. The conversion chooses the time that continues the previous
frames and is not in the future.
"""

from __future__ import annotations

from collections.abc import Sequence

import can

from freeflyer_adapters.recording.wall_clock import WallClock

STAMPED_BY_THE_WALL_CLOCK = ("local", "socketcan")
"""Interfaces with stamps of the kernel's CLOCK_REALTIME; other interfaces have other epochs."""
FOLLOWED = 5_000_000
"""Smallest step that is corrected [ns]; smaller ones may be errors of reading the clocks."""


class FrameTimes:
    """Converter of frame times; create it before the bus is opened."""

    def __init__(self, clock: WallClock) -> None:
        self._clock = clock
        self._steps = [_followed(clock.step(), 0)]
        """Possible steps of the wall clock at the stamping of the next frames [ns]."""
        self._last = self._from = clock.now() * 1e-9

    def corrected(self, frames: Sequence[can.Message], is_all: bool) -> list[can.Message]:
        """Change the times of the frames to those of the recording and return the sorted frames.

        `frames`: received since the last call, in order. `is_all`: the bus has no further frame.
        """
        self._steps.append(_followed(self._clock.step(), self._steps[-1]))
        now = self._clock.now() * 1e-9
        latest = self._from
        for frame in frames:
            frame.timestamp = latest = self._time(frame.timestamp, latest, now)
        if is_all:
            # Keep the previous step: a frame may arrive between reading the bus and the clock.
            del self._steps[:-2]
            self._from = now
        # The senders of a `local` channel are read one after another, so frames may be unordered.
        ordered = sorted(frames, key=lambda frame: frame.timestamp)
        for frame in ordered:
            frame.timestamp = self._last = max(frame.timestamp, self._last)
        return ordered

    def _time(self, stamp: float, latest: float, now: float) -> float:
        """Return the time of a frame [s]; `latest` is the time of the previous frame."""
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
    """Return `step` if it differs from `before` by at least `FOLLOWED`, else `before` [ns]."""
    return step if abs(step - before) >= FOLLOWED else before
