"""Mutations of bytes, as links, disks and attackers cause them, from a seeded generator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from random import Random

LONGEST = 1 << 16
"""Maximum size of an input after mutation [bytes]."""
BOUNDARIES = (
    0,
    1,
    2,
    0x7F,
    0x80,
    0xFF,
    0x100,
    0x7FFF,
    0x8000,
    0xFFFF,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
    1 << 63,
    (1 << 64) - 1,
)
"""Limits of integers of 8 to 64 bits, with and without sign."""
INTERESTING = (
    b"\x00",
    b"\xff",
    b"\x7f\xf0\x00\x00\x00\x00\x00\x00",
    b"\x00\x00\x00\x00\x00\x00\xf8\x7f",
    b"\xc3\x28",
    b"\xed\xa0\x80",
)
"""Zeros, ones, infinity and NaN as doubles, invalid UTF-8, a surrogate."""


def bit(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    if data:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def byte(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    if data:
        data[rng.randrange(len(data))] = rng.randrange(256)


def truncate(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    del data[rng.randrange(len(data) + 1) :]


def extend(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    data += rng.randbytes(rng.choice((1, 2, 3, 4, 8, 64, 500)))


def remove(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    first = rng.randrange(len(data) + 1)
    del data[first : first + rng.randrange(1, 17)]


def repeat(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    first = rng.randrange(len(data) + 1)
    data[first:first] = data[first : first + rng.randrange(1, 33)] * rng.randrange(1, 5)


def boundary(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    """Write a boundary integer of random width and byte order, in place of a length or count."""
    width, order = rng.choice((1, 2, 4, 8)), rng.choice(("little", "big"))
    if len(data) >= width:
        first = rng.randrange(len(data) - width + 1)
        value = (rng.choice(BOUNDARIES) + rng.randrange(-1, 2)) % (1 << 8 * width)
        data[first : first + width] = value.to_bytes(width, order)  # type: ignore[arg-type]


def interesting(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    piece, first = rng.choice(INTERESTING), rng.randrange(len(data) + 1)
    data[first : first + len(piece)] = piece


def splice(rng: Random, data: bytearray, seeds: Sequence[bytes]) -> None:
    """Join the start of one valid input and the end of another."""
    other = rng.choice(seeds)
    data[rng.randrange(len(data) + 1) :] = other[rng.randrange(len(other) + 1) :]


KINDS: Sequence[Callable[[Random, bytearray, Sequence[bytes]], None]] = (
    bit, byte, truncate, extend, remove, repeat, boundary, interesting, splice,
)  # fmt: skip


def damaged(rng: Random, seeds: Sequence[bytes], most: int = 4) -> bytes:
    """Return a valid input with up to `most` mutations; rarely an intact one, or random bytes."""
    kind = rng.random()
    if kind < 0.02:
        return rng.randbytes(rng.randrange(300))
    data = bytearray(rng.choice(seeds))
    for _ in range(0 if kind < 0.04 else rng.randrange(1, most + 1)):
        rng.choice(KINDS)(rng, data, seeds)
    return bytes(data[:LONGEST])
