"""Checksum for samples of Odometry. The checksum detects values that were corrupted in transit.

CDR and rmw_zenoh have no checksum. The checksum of this module is a CRC-16 (CCITT, as in E2E
profile 5) over the message and the attachment. The checksum is stored in the two option bytes of
CDR's encapsulation header. Other receivers, for example a plain ROS 2 node, ignore the option bytes
(DDSI-RTPS 2.5, 10.2). A sample with a checksum is called sealed.

Later versions of CDR use the two lowest option bits for the padding size. Therefore these two bits
must stay zero. The sender increments the time stamp by 1 ns until both bits of the checksum are
zero. If both option bytes are zero, the sample has no checksum. Samples of a plain ROS 2 node have
no checksum.

The checksum protects against errors. TLS protects against attackers.
"""

from __future__ import annotations

from binascii import crc_hqx

PADDING_BITS = 0b11
FIRST, LAST = 2, 4
"""Range of the option bytes in the payload: FIRST is included, LAST is not."""


def checksum(payload: bytes, attachment: bytes) -> int:
    """Return the checksum of a sample. It covers all bytes except the option bytes."""
    return crc_hqx(attachment, crc_hqx(payload[LAST:], crc_hqx(payload[:FIRST], 0xFFFF)))


def is_sealable(code: int) -> bool:
    """Return True if the checksum may be stored in the option bytes.

    The padding bits of the checksum must be zero. The whole checksum must not be zero, because zero
    means that a sample has no checksum.
    """
    return code != 0 and not code & PADDING_BITS


def sealed(payload: bytes, attachment: bytes) -> bytes:
    """Return the payload with its checksum. Does not check `is_sealable`."""
    return payload[:FIRST] + checksum(payload, attachment).to_bytes(2, "big") + payload[LAST:]


def is_sealed(payload: bytes) -> bool:
    return len(payload) >= LAST and payload[FIRST:LAST] != b"\0\0"


def is_intact(payload: bytes, attachment: bytes) -> bool:
    """Return True if the checksum of a sealed payload is correct."""
    return int.from_bytes(payload[FIRST:LAST], "big") == checksum(payload, attachment)
