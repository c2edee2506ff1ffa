"""End-to-end protection of a frame by AUTOSAR E2E profile 5: a CRC-16 over data and data ID, and a counter.

Reference: AUTOSAR FO, Specification of E2E Protocol (document 849), profile 5. The CRC is computed by the `autosar-e2e` package;
the counter's rules (repetition, loss, wrong sequence) are here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from e2e.p05 import e2e_p05_check, e2e_p05_protect

HEADER_BYTES = 3
"""CRC (2, little-endian) and counter (1)."""


class Status(Enum):
    ok = "ok"
    some_lost = "some lost"
    repeated = "repeated"
    wrong_sequence = "wrong sequence"
    wrong_crc = "wrong CRC"

    @property
    def accepted(self) -> bool:
        return self in (Status.ok, Status.some_lost)


class Protector:
    """The sender's side: one counter a frame."""

    def __init__(self, data_id: int, offset: int = 0) -> None:
        self.data_id, self.offset = data_id, offset
        self._counter = 0

    def protect(self, data: bytearray) -> None:
        """Write counter and CRC into the frame's header."""
        data[self.offset + 2] = self._counter
        e2e_p05_protect(data, self.data_id, offset=self.offset, increment_counter=False)
        self._counter = (self._counter + 1) & 0xFF


@dataclass
class Checker:
    """The receiver's side. `most_lost` is MaxDeltaCounter: how far the counter may have run since the last good frame."""

    data_id: int
    offset: int = 0
    most_lost: int = 50
    counts: dict[Status, int] = field(default_factory=lambda: dict.fromkeys(Status, 0))
    _counter: int | None = None

    def forget(self) -> None:
        """Take the next good frame as the first, after frames were thrown away unread."""
        self._counter = None

    def check(self, data: bytes | bytearray) -> Status:
        status = self._status(data)
        self.counts[status] += 1
        return status

    def _status(self, data: bytes | bytearray) -> Status:
        if len(data) < self.offset + HEADER_BYTES or not e2e_p05_check(
            bytes(data), self.data_id, offset=self.offset
        ):
            return Status.wrong_crc
        counter, before = data[self.offset + 2], self._counter
        self._counter = counter
        if before is None:
            return Status.ok
        step = (counter - before) & 0xFF
        if step == 0:
            return Status.repeated
        if step == 1:
            return Status.ok
        # After too long a gap the frame is not used, but the next one is measured against it.
        return Status.some_lost if step <= self.most_lost else Status.wrong_sequence
