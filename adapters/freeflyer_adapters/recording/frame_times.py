"""Conversion of frame times in a CAN log to the time scale of the recording.

The time scale of the recording is the wall clock without steps (see `wall_clock`). A step is a
change of the wall clock to another time. The kernel stamps a frame with the wall clock when the
frame arrives. Steps are measured each time the bus is read, but frames arrive between two readings.
If there was a step between two readings, a frame may have been stamped before or after this step.
Then two times are possible for the frame. The conversion chooses the time that is not before the
times of the previous frames and not in the future.
"""

from __future__ import annotations

from collections.abc import Sequence

import can

from freeflyer_adapters.recording.wall_clock import WallClock

STAMPED_BY_THE_WALL_CLOCK = ("local", "socketcan")
"""Interfaces that stamp frames with CLOCK_REALTIME.

The times of other interfaces may start at another zero. These times are not converted."""
FOLLOWED = 5_000_000
"""Smallest step that is corrected [ns].

A smaller difference may be only an error in reading the two clocks."""


class FrameTimes:
    """Converter of frame times. Create the converter before the bus is opened."""

    def __init__(self, clock: WallClock) -> None:
        self._clock = clock
        self._steps = [_followed(clock.step(), 0)]
        """Possible total steps for the next frames [ns]: the totals before and after new steps."""
        self._last = self._from = clock.now() * 1e-9

    def corrected(self, frames: Sequence[can.Message], is_all: bool) -> list[can.Message]:
        """Convert the times of the frames to the time scale of the recording.

        Return the frames, sorted by time. `frames`: frames received since the last call, in the
        order of reception. `is_all`: True if the bus has no further frame.
        """
        self._steps.append(_followed(self._clock.step(), self._steps[-1]))
        now = self._clock.now() * 1e-9
        latest = self._from
        for frame in frames:
            frame.timestamp = latest = self._time(frame.timestamp, latest, now)
        if is_all:
            # Keep the newest two totals. The clock is read after the bus, so a frame that was
            # stamped before the newest step may still arrive with the next call.
            del self._steps[:-2]
            self._from = now
        # The senders of a `local` channel are read one after another. So frames may be unordered.
        ordered = sorted(frames, key=lambda frame: frame.timestamp)
        for frame in ordered:
            frame.timestamp = self._last = max(frame.timestamp, self._last)
        return ordered

    def _time(self, stamp: float, latest: float, now: float) -> float:
        """Return the time of a frame [s]. `latest` is the time of the previous frame."""
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
