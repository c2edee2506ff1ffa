"""End-to-end protection by AUTOSAR E2E profile 5.

The profile adds a counter and a CRC-16 to each frame. The CRC covers the data and the data ID.

Reference: AUTOSAR FO, Specification of E2E Protocol (document 849), profile 5. The `autosar-e2e`
package computes the CRC. This module checks the counter for repetition, loss and wrong sequence.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from e2e.p05 import e2e_p05_check, e2e_p05_protect

HEADER_BYTES = 3
"""Size of the E2E header: a little-endian CRC of 2 bytes, then a counter of 1 byte."""


class Status(Enum):
    """Result of the check of one received frame."""

    ok = "ok"
    some_lost = "some lost"
    repeated = "repeated"
    wrong_sequence = "wrong sequence"
    wrong_crc = "wrong CRC"

    @property
    def accepted(self) -> bool:
        return self in (Status.ok, Status.some_lost)


class Protector:
    """Sender side. Adds a CRC and a counter to every frame.

    `offset`: first byte of the E2E header in the frame.
    """

    def __init__(self, data_id: int, offset: int = 0) -> None:
        self.data_id, self.offset = data_id, offset
        self._counter = 0

    def protect(self, data: bytearray) -> None:
        """Write the counter and the CRC into the E2E header of `data`."""
        data[self.offset + 2] = self._counter
        e2e_p05_protect(data, self.data_id, offset=self.offset, increment_counter=False)
        self._counter = (self._counter + 1) & 0xFF


@dataclass
class Checker:
    """Receiver side. Checks the CRC and the counter of every frame.

    `offset`: first byte of the E2E header. `most_lost`: MaxDeltaCounter of the profile. This is the
    largest accepted step of the counter since the last valid frame.
    """

    data_id: int
    offset: int = 0
    most_lost: int = 50
    counts: dict[Status, int] = field(default_factory=lambda: dict.fromkeys(Status, 0))
    _counter: int | None = None

    def reset(self) -> None:
        """Accept any counter in the next valid frame.

        Call this method after frames were discarded without a check.
        """
        self._counter = None

    def check(self, data: bytes | bytearray) -> Status:
        """Return the status of a received frame, and count it in `counts`."""
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
        # If the step is too large, the frame is rejected. Nevertheless, its counter becomes the
        # reference for the next frame.
        return Status.some_lost if step <= self.most_lost else Status.wrong_sequence
