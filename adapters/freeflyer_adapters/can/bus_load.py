"""Worst-case transmission times of CAN frames, and the bus load of a link."""

from __future__ import annotations

from collections.abc import Sequence


def bus_load(
    frames: Sequence[tuple[int, bool]], cycle: float, nominal: float = 1e6, data: float = 5e6
) -> float:
    """Return the worst-case bus load (a fraction) of frames that are each sent once per cycle.

    `frames`: (payload bytes, is CAN FD); `cycle` [s]; `nominal`, `data`: bit rates [bit/s]. All
    possible stuff bits are counted.
    """
    return sum(frame_time(size, is_fd, nominal, data) for size, is_fd in frames) / cycle


def frame_time(size: int, is_fd: bool, nominal: float = 1e6, data: float = 5e6) -> float:
    """Return the longest transmission time [s] of a frame with an 11-bit identifier.

    `size`: payload [bytes]; `nominal`, `data`: bit rates [bit/s]. The interframe space is included
    (ISO 11898-1:2015). A CAN FD frame switches the bit rate:

    - Arbitration phase: SOF, identifier, r1, IDE, FDF, r0, BRS with stuff bits.
    - Data phase: ESI, DLC and data with stuff bits, stuff count, CRC with fixed stuff bits.
    - At the nominal rate again: CRC delimiter, ACK, EOF, intermission.
    """
    if not is_fd:
        bits = 44 + 8 * size
        return (bits + (34 + 8 * size - 1) // 4 + 3) / nominal
    arbitration = 1 + 11 + 1 + 1 + 1 + 1 + 1
    crc = 17 if size <= 16 else 21
    stuffed = arbitration + (arbitration - 1) // 4
    body = 1 + 4 + 8 * size
    fast = body + body // 4 + 4 + crc + (crc + 4 + 3) // 4
    return (stuffed + 1 + 2 + 1 + 7 + 3) / nominal + fast / data
