"""nav_msgs/msg/Odometry in the wire format of ROS 2 (XCDR1, OMG DDS-XTypes).

The message contains a time stamp, a pose and a twist. REP 105 and the message definition define the
frames. The pose is the pose of the frame `child_frame_id` in the frame `header.frame_id`. In this
project, these frames are the base B and the inertial frame I. The twist is expressed in
`child_frame_id`, that is, in B. All other modules of this project express velocities in I.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from freeflyer.fmi.component import Array

TYPE_NAME = "nav_msgs::msg::dds_::Odometry_"
TYPE_HASH = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
"""Type hash by REP 2016. A test compares the hash with the message definition."""
POSE_NUMBERS, COVARIANCE, TWIST_NUMBERS = 7, 36, 6
NUMBERS = POSE_NUMBERS + COVARIANCE + TWIST_NUMBERS + COVARIANCE
LONGEST_NAME = 256


class MessageError(ValueError):
    """The bytes are not an Odometry message."""


@dataclass(frozen=True, kw_only=True)
class Odometry:
    """Time stamp [ns since the epoch], names of the two frames, pose of B, and twist of B.

    position (3) [m] and orientation (4, xyzw) are expressed in I. velocity (6) [m/s, rad/s] is the
    twist, expressed in B.
    """

    stamp: int
    frame: str
    child_frame: str
    position: Array
    orientation: Array
    velocity: Array


class OdometryWriter:
    """Writer of messages with fixed frame names. The layout of the messages is computed once."""

    def __init__(self, frame: str, child_frame: str) -> None:
        head = bytearray(b"\x00\x01\x00\x00")  # CDR, little-endian
        head += bytes(8)
        for name in (frame, child_frame):
            _align(head, 4)
            text = name.encode() + b"\x00"
            head += struct.pack("<I", len(text)) + text
        _align(head, 8)
        self._first = len(head)
        self._data = head + bytes(8 * NUMBERS)
        self._numbers = np.frombuffer(memoryview(self._data)[self._first :], dtype="<f8")

    def write(self, stamp: int, position: Array, orientation: Array, velocity: Array) -> bytes:
        """Return the bytes of a message. All covariances are 0.

        The shapes and units of the arguments are the same as in `Odometry`.
        """
        struct.pack_into("<iI", self._data, 4, stamp // 1_000_000_000, stamp % 1_000_000_000)
        numbers = self._numbers
        numbers[0:3] = position
        numbers[3:7] = orientation
        numbers[43:49] = velocity
        return bytes(self._data)


def read(data: bytes) -> Odometry:
    """Read an Odometry message in either byte order. The numbers may be NaN or infinite.

    Raises MessageError if the bytes are not an Odometry message.
    """
    # Read the header: encapsulation and time stamp.
    if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
        raise MessageError(
            f"the encapsulation is {data[:4].hex()}; CDR (00 00 or 00 01) is expected"
        )
    order = "<" if data[1] else ">"
    seconds, nanoseconds = _take(order + "iI", data, 4)
    if not 0 <= nanoseconds < 1_000_000_000:
        raise MessageError(f"the time stamp has {nanoseconds} ns; 0 to 999999999 are expected")
    # Read two frame names. Each name is a length, followed by a zero-terminated string.
    place, names = 12, []
    for _ in range(2):
        place += -(place - 4) % 4
        (length,) = _take(order + "I", data, place)
        if not 1 <= length <= LONGEST_NAME or place + 4 + length > len(data):
            raise MessageError(f"a frame name has {length} bytes; 1 to {LONGEST_NAME} are expected")
        text = data[place + 4 : place + 4 + length]
        if text.find(0) != length - 1:
            raise MessageError("the last byte of a frame name is expected to be its only zero byte")
        try:
            names.append(text[:-1].decode())
        except UnicodeDecodeError as error:
            raise MessageError("a frame name is not UTF-8") from error
        place += 4 + length
    place += -(place - 4) % 8
    # Read the numbers. A serialiser may pad the message to a multiple of four bytes.
    if not place + 8 * NUMBERS <= len(data) <= place + 8 * NUMBERS + 3:
        raise MessageError(f"the message has {len(data)} bytes; {place + 8 * NUMBERS} are expected")
    numbers = np.frombuffer(data, dtype=order + "f8", count=NUMBERS, offset=place).astype(float)
    return Odometry(
        stamp=seconds * 1_000_000_000 + nanoseconds,
        frame=names[0],
        child_frame=names[1],
        position=numbers[0:3],
        orientation=numbers[3:7],
        velocity=numbers[43:49],
    )


def _take(form: str, data: bytes, place: int) -> tuple[Any, ...]:
    try:
        return struct.unpack_from(form, data, place)
    except struct.error as error:
        raise MessageError(f"the message ends after {len(data)} bytes") from error


def _align(data: bytearray, size: int) -> None:
    """Append zero bytes until the length is a multiple of `size`.

    This length does not include the four bytes of the encapsulation header.
    """
    data += bytes(-(len(data) - 4) % size)
