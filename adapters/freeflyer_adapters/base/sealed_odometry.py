"""A checksum for samples of Odometry, which detects values corrupted in transit.

CDR and rmw_zenoh have no checksum. This one is a CRC-16 (CCITT, as in E2E profile 5) over message
and attachment. It is stored in the two option bytes of CDR's encapsulation header, which receivers
ignore (DDSI-RTPS 2.5, 10.2). Later versions of CDR use the two lowest bits for the padding size,
so these bits must stay zero: the sender increments the time stamp by 1 ns until they are.
Options of zero mean that there is no checksum, as for a plain ROS 2 node. The checksum protects
against errors; TLS protects against attackers.
"""

from __future__ import annotations

from binascii import crc_hqx

PADDING_BITS = 0b11
FIRST, LAST = 2, 4
"""Byte range of the options in the payload."""


def checksum(payload: bytes, attachment: bytes) -> int:
    """Return the checksum of a sample, without its option bytes."""
    return crc_hqx(attachment, crc_hqx(payload[LAST:], crc_hqx(payload[:FIRST], 0xFFFF)))


def is_sealable(code: int) -> bool:
    """Return True if the checksum may be stored in the options: non-zero, padding bits zero."""
    return code != 0 and not code & PADDING_BITS


def sealed(payload: bytes, attachment: bytes) -> bytes:
    """Return the payload with its checksum, without a check of the bits."""
    return payload[:FIRST] + checksum(payload, attachment).to_bytes(2, "big") + payload[LAST:]


def is_sealed(payload: bytes) -> bool:
    return len(payload) >= LAST and payload[FIRST:LAST] != b"\0\0"


def is_intact(payload: bytes, attachment: bytes) -> bool:
    """Return True if the checksum of a sealed payload is correct."""
    return int.from_bytes(payload[FIRST:LAST], "big") == checksum(payload, attachment)
