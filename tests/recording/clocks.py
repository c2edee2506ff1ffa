"""Simulated clocks that a test can set, and a bus that stamps frames with them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
from loops import START, head

from freeflyer_adapters.foundation.environment import Environment
from freeflyer_adapters.recording.ring_header import CanChannel, RecordingHeader

MONOTONIC = 5_000_000_000
"""Monotonic clock at the start of a test [ns]."""


class Clocks(Environment):
    def __init__(self) -> None:
        self.passed, self.set_by = 0, 0
        self.waiting: deque[can.Message] = deque()

    def monotonic_ns(self) -> int:
        return MONOTONIC + self.passed

    def time_ns(self) -> int:
        return START + self.passed + self.set_by

    def bus(self, **arguments: Any) -> Any:
        return FakeBus(self.waiting)

    @property
    def true(self) -> float:
        """True time [s since the epoch], without the steps of the wall clock."""
        return (START + self.passed) * 1e-9

    def add_frame(self, number: int = 0, late: int = 0) -> float:
        """Add a frame that was stamped `late` [ns] ago; return its true time."""
        stamp = (self.time_ns() - late) * 1e-9
        self.waiting.append(
            can.Message(
                timestamp=stamp, arbitration_id=0x181, is_extended_id=False, data=[number % 256]
            )
        )
        return self.true - late * 1e-9


class FakeBus:
    def __init__(self, waiting: deque[can.Message]) -> None:
        self._waiting = waiting

    def recv(self, timeout: float) -> can.Message | None:
        return self._waiting.popleft() if self._waiting else None

    def shutdown(self) -> None:
        pass


def run_head(directory: Path, can_channels: Sequence[CanChannel] = ()) -> RecordingHeader:
    """Return the header of a run that starts with the clocks."""
    return replace(head(directory), clock_offset=START - MONOTONIC, can=can_channels)
