"""A checksum for samples of Odometry, where CDR and rmw_zenoh have none: a value that was changed on its way is not used.

It is a CRC-16 (CCITT, as in E2E profile 5) over message and attachment, and lies in the two
bytes of options of CDR's encapsulation header, which receivers ignore (DDSI-RTPS 2.5, 10.2) but for the two lowest bits, in which
later versions of CDR count padding: those stay zero, as senders move their time stamp on, by nanoseconds, until they are. Options
of zero say that there is no checksum: a plain ROS 2 node's. It is against errors; against attackers there is TLS.
"""

from __future__ import annotations

from binascii import crc_hqx

PADDING_BITS = 0b11
FIRST, LAST = 2, 4
"""Where the options are."""


def checksum(payload: bytes, attachment: bytes) -> int:
    """Of a sample; what its options say makes no difference."""
    return crc_hqx(attachment, crc_hqx(payload[LAST:], crc_hqx(payload[:FIRST], 0xFFFF)))


def is_sealable(code: int) -> bool:
    """Whether a checksum can stand for itself in the options."""
    return code != 0 and not code & PADDING_BITS


def sealed(payload: bytes, attachment: bytes) -> bytes:
    """The payload with its checksum, whatever its bits are."""
    return payload[:FIRST] + checksum(payload, attachment).to_bytes(2, "big") + payload[LAST:]


def is_sealed(payload: bytes) -> bool:
    return len(payload) >= LAST and payload[FIRST:LAST] != b"\0\0"


def is_intact(payload: bytes, attachment: bytes) -> bool:
    """Of a sealed payload."""
    return int.from_bytes(payload[FIRST:LAST], "big") == checksum(payload, attachment)
