"""How long frames occupy a CAN bus at most, and which share of it a link takes."""

from __future__ import annotations

from collections.abc import Sequence


def bus_load(
    frames: Sequence[tuple[int, bool]], cycle: float, nominal: float = 1e6, data: float = 5e6
) -> float:
    """Worst share of the bus that frames of (bytes, is CAN FD) take, each once in a cycle [s] (with every stuff bit there can be)."""
    return sum(frame_time(size, is_fd, nominal, data) for size, is_fd in frames) / cycle


def frame_time(size: int, is_fd: bool, nominal: float = 1e6, data: float = 5e6) -> float:
    """Longest time [s] that a frame with an 11-bit identifier occupies the bus, interframe space included (ISO 11898-1:2015).

    CAN FD with bit-rate switching: arbitration phase of SOF, identifier, r1, IDE, FDF, r0, BRS with stuff bits, and CRC delimiter,
    ACK, EOF and intermission after the data phase; the data phase holds ESI, DLC, data (all with stuff bits), stuff count and CRC
    with its fixed stuff bits.
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
