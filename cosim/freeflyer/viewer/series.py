"""Compact encoding of a time series for the page of the viewer.

A value is `offset + scale * integer`. The differences of the integers are written as zigzag
varints (as in Protocol Buffers), compressed by DEFLATE, and encoded in base64.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from freeflyer.fmi.component import Array

LARGEST = 2**53
"""Largest integer that JavaScript represents exactly."""
SMALLEST = 1e-300
"""Smallest resolution. With a smaller one, the integers could overflow."""


def encoded(values: Array, quantum: float) -> dict[str, Any]:
    """Return a series (n) with a resolution of `quantum`, as JSON types.

    The resolution is coarser if the range of the values needs more than 53 bits. Values that are
    not finite are listed in `nan` as half-open ranges of indices.
    """
    values = np.asarray(values, dtype=float)
    finite = np.isfinite(values)
    known = values[finite]
    if not known.size or known.min() == known.max():
        offset, scale, data = float(known[0]) if known.size else 0.0, 0.0, ""
    else:
        offset = float(known.min())
        span = float(known.max()) - offset
        if not np.isfinite(span):  # the range exceeds that of a double
            offset, span = 0.0, float(np.abs(known).max())
        scale = max(quantum, span / LARGEST * 4.0, SMALLEST)
        filled = np.where(finite, values, offset)
        numbers = np.rint((filled - offset) / scale).astype(np.int64)
        data = base64.b64encode(_deflated(_varints(np.diff(numbers, prepend=0)))).decode("ascii")
    series: dict[str, Any] = {"n": int(values.size), "scale": scale, "offset": offset, "data": data}
    gaps = [[int(first), int(last)] for first, last in _runs(~finite)]
    return {**series, "nan": gaps} if gaps else series


def _varints(differences: Any) -> bytes:
    """Return 64-bit integers as little-endian zigzag varints."""
    zigzag = ((differences << 1) ^ (differences >> 63)).astype(np.uint64)
    groups = np.arange(10, dtype=np.uint64) * np.uint64(7)
    septets = (zigzag[:, None] >> groups) & np.uint64(127)
    length = np.maximum(10 - np.argmax(septets[:, ::-1] != 0, axis=1), 1)
    length[zigzag == 0] = 1
    place = np.arange(10)
    octets = septets.astype(np.uint8) | np.where(place < length[:, None] - 1, 128, 0).astype(
        np.uint8
    )
    data: bytes = octets[place < length[:, None]].tobytes()
    return data


def _deflated(data: bytes) -> bytes:
    compressor = zlib.compressobj(9, zlib.DEFLATED, -15)
    return compressor.compress(data) + compressor.flush()


def _runs(flags: Any) -> Iterator[tuple[int, int]]:
    """Yield the half-open ranges in which `flags` (n) is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    yield from zip(edges[::2], edges[1::2], strict=True)


def reduced(time: Array, values: Array, most: int) -> tuple[Array, Array]:
    """Return at most `most` samples of a series (n) that keep its extremes.

    Each of equal intervals of rows keeps the samples with the smallest and the largest value. So a
    spike of one sample remains visible. Values that are not finite are kept once per interval.
    """
    count = time.size
    if count <= most:
        return time, values
    edges = np.linspace(0, count, most // 2 + 1).astype(int)
    low = np.where(np.isfinite(values), values, np.inf)
    high = np.where(np.isfinite(values), values, -np.inf)
    kept = {0, count - 1}
    for first, last in pairwise(edges):
        kept.update(
            (first + int(np.argmin(low[first:last])), first + int(np.argmax(high[first:last])))
        )
    rows = np.array(sorted(kept))
    return time[rows], values[rows]
