"""Virtual time for a facility and its host in one process. Runs are fast and reproducible.

The host is the program that runs the control loop. The code of the host is the same as in real
time. The CAN frames and Zenoh samples also contain the same bytes. There are three differences:

- Buses and Zenoh sessions are in memory.
- Computation takes no virtual time.
- The facility runs its next cycle only when the host waits.

Therefore a delay of the computer has no effect on the times of the reactions to a fault. A test of
10,000 schedules of faults takes minutes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import can
import zenoh

from freeflyer_adapters.facility.memory_can import MemoryBus
from freeflyer_adapters.facility.memory_zenoh import MemorySession, Net
from freeflyer_adapters.foundation.environment import Environment

START = 1_000_000_000
"""Start time of both clocks, the monotonic clock and the wall clock [ns].

This time is not zero, because zero may mean that a time is not set."""


class VirtualTime(Environment):
    """An environment whose time advances only while the host waits."""

    def __init__(self) -> None:
        self._now = START
        self._facility: Iterator[None] | None = None
        self._period = self._next = 0
        self._is_stepping = False
        self._channels: dict[str, list[MemoryBus]] = {}
        self._net = Net()

    def play(self, facility: Iterator[None], period: int) -> None:
        """Run one cycle of `facility` every `period` [ns] from now on."""
        self._facility, self._period = facility, period
        self._next = self._now + period

    def monotonic_ns(self) -> int:
        return self._now

    def time_ns(self) -> int:
        return self._now

    def sleep(self, duration: float) -> None:
        self.pass_until(duration, lambda: False)

    def bus(self, **arguments: Any) -> can.BusABC:
        channel = str(arguments["channel"])
        nodes = self._channels.setdefault(channel, [])
        return MemoryBus(channel, nodes, self, arguments.get("can_filters"))

    def session(self, config: zenoh.Config) -> Any:
        return MemorySession(self._net)

    def pass_until(self, duration: float, happened: Callable[[], bool]) -> bool:
        """Advance by `duration` [s], or until `happened` returns True after a facility cycle.

        Return whether `happened` has returned True. Raises RuntimeError if the facility itself
        calls this method.
        """
        if self._is_stepping:
            raise RuntimeError(
                "the facility itself waits in virtual time; this wait would never end"
            )
        # Advance by at least 1 ns. Otherwise a short remaining time is rounded to zero, and a
        # caller that waits repeatedly for this time would never end.
        end = self._now + max(1, round(duration * 1e9))
        while self._facility is not None and self._next <= end:
            self._now = self._next
            self._next += self._period
            self._is_stepping = True
            try:
                next(self._facility)
            except StopIteration:
                self._facility = None  # the facility has ended, because a device model failed
            finally:
                self._is_stepping = False
            if happened():
                return True
        self._now = max(self._now, end)
        return False
