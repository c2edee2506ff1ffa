"""Serialisation of many messages in CDR (XCDR1, little-endian).

All messages of a layout have the same length. A template contains one message with zeros in place
of the numbers. The template is copied for each message, and the numbers are filled in.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeflyer_adapters.recording.ring import Rows

ENCAPSULATION = b"\x00\x01\x00\x00"
Numbers = Callable[[Rows], NDArray[np.float64] | NDArray[np.int64]]
"""Function of `Rows` that returns n numbers of eight bytes for each message, shape (rows, n)."""


@dataclass(frozen=True)
class Place:
    """Numbers in a message: offset [bytes], count, and the function that returns the numbers."""

    offset: int
    size: int
    numbers: Numbers


class Layout:
    """The layout of a message.

    Add the fields in the order of the message definition. Then `bytes_of` serialises one
    message for each row.
    """

    def __init__(self, frame: str) -> None:
        """Start the message with a std_msgs/Header, whose frame ID is `frame`."""
        self._template = bytearray(ENCAPSULATION + bytes(8))
        self._places: list[Place] = []
        self.text(frame)

    def text(self, text: str) -> None:
        """Add a string with constant content."""
        self._align(4)
        data = text.encode() + b"\0"
        self._template += struct.pack("<I", len(data)) + data

    def length(self, count: int) -> None:
        """Add the length of a sequence. Add the elements after this call."""
        self._align(4)
        self._template += struct.pack("<I", count)

    def numbers(self, size: int, numbers: Numbers) -> None:
        """Add `size` numbers of eight bytes. The function `numbers` returns them for given rows."""
        if size:
            self._align(8)
            self._places.append(Place(len(self._template), size, numbers))
            self._template += bytes(8 * size)

    def zeros(self, size: int) -> None:
        """Add `size` numbers of eight bytes that are zero."""
        self._align(8)
        self._template += bytes(8 * size)

    def texts(self, texts: Sequence[str]) -> None:
        self.length(len(texts))
        for text in texts:
            self.text(text)

    def _align(self, size: int) -> None:
        """Pad to a multiple of `size`, counted from the end of the encapsulation header."""
        self._template += bytes(-(len(self._template) - len(ENCAPSULATION)) % size)

    @property
    def size(self) -> int:
        return len(self._template)

    def bytes_of(self, rows: Rows) -> list[bytes]:
        """Return one message per row, stamped with the wall time of the row."""
        block = np.tile(np.frombuffer(bytes(self._template), dtype=np.uint8), (len(rows), 1))
        stamps = np.stack(np.divmod(rows.times[:, 0], 1_000_000_000), axis=1).astype("<i4")
        block[:, 4:12].view("<i4")[...] = stamps
        for place in self._places:
            numbers = place.numbers(rows)
            part = block[:, place.offset : place.offset + 8 * place.size]
            part.view(numbers.dtype.newbyteorder("<"))[...] = numbers
        data, size = block.tobytes(), self.size
        return [data[i * size : (i + 1) * size] for i in range(len(rows))]
