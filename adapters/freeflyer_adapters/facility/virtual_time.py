"""Both ends of a facility's links in one process, on one virtual time: as fast as it can be computed, and the same every time.

The host's devices, limits, quality monitors and state machines are those that run in real time, to the line; the frames and samples
are the same bytes. What is different: buses and sessions are memory, no time passes while somebody computes, and the facility's
next cycle comes when the host waits for something. So a fault's reaction comes at an exact instant, and 10,000 schedules of faults
take minutes.
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
"""[ns] of both clocks, so that nothing is taken for a time that was never set."""


class VirtualTime(Environment):
    """`facility` is what happens every `period` [ns]; it is stepped while somebody waits, and never within itself."""

    def __init__(self) -> None:
        self._now = START
        self._facility: Iterator[None] | None = None
        self._period = self._next = 0
        self._is_stepping = False
        self._channels: dict[str, list[MemoryBus]] = {}
        self._net = Net()

    def play(self, facility: Iterator[None], period: int) -> None:
        """From now on, a cycle each `period` [ns]."""
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
        """Let `duration` [s] pass, or less if something has `happened`."""
        if self._is_stepping:
            raise RuntimeError(
                "the facility itself waits for something in virtual time; it would wait for ever"
            )
        # At least something, or who waits for a remainder would wait for ever.
        end = self._now + max(1, round(duration * 1e9))
        while self._facility is not None and self._next <= end:
            self._now = self._next
            self._next += self._period
            self._is_stepping = True
            try:
                next(self._facility)
            except StopIteration:
                self._facility = None  # its model has failed
            finally:
                self._is_stepping = False
            if happened():
                return True
        self._now = max(self._now, end)
        return False
