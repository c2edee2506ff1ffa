"""Worst-case transmission times of CAN frames, and the bus load of a link."""

from __future__ import annotations

from collections.abc import Sequence


def bus_load(
    frames: Sequence[tuple[int, bool]], cycle: float, nominal: float = 1e6, data: float = 5e6
) -> float:
    """Return the worst-case bus load (a fraction) of frames that are each sent once per cycle.

    `frames`: one pair (payload [bytes], whether it is a CAN FD frame) for each frame. `cycle` [s]:
    period of the frames. `nominal`, `data`: bit rates [bit/s]. The largest possible number of stuff
    bits is counted.
    """
    return sum(frame_time(size, is_fd, nominal, data) for size, is_fd in frames) / cycle


def frame_time(size: int, is_fd: bool, nominal: float = 1e6, data: float = 5e6) -> float:
    """Return the longest transmission time [s] of a frame with an 11-bit identifier.

    `size`: payload [bytes]. `nominal`, `data`: bit rates [bit/s]. The interframe space is included
    (ISO 11898-1:2015). A CAN FD frame has three parts:

    - Arbitration phase, at the nominal bit rate: SOF, identifier, r1, IDE, FDF, r0 and BRS. This
      part has stuff bits.
    - Data phase, at the data bit rate: ESI, DLC, data, stuff count and CRC. ESI, DLC and data have
      stuff bits. The CRC has fixed stuff bits.
    - End of the frame, at the nominal bit rate: CRC delimiter, ACK, EOF and intermission.
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
