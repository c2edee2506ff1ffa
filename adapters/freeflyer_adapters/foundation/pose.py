"""Rotations and pose distances without SciPy, for use in every cycle.

These functions are ten times as fast as the rotations of SciPy. The tests compare the results of
both.
"""

from __future__ import annotations

import math

import numpy as np

from freeflyer.fmi.component import Array


def rotated(orientation: Array, vector: Array, *, back: bool = False) -> tuple[float, float, float]:
    """Rotate `vector` by `orientation`, a unit quaternion (4, xyzw).

    With the rotation matrix R of `orientation`, the result is R times `vector`. If `back` is True,
    the result is R^T times `vector`.
    """
    x, y, z, w = orientation.tolist()
    a, b, c = vector.tolist()
    if back:
        x, y, z = -x, -y, -z
    p, q, r = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * p + y * r - z * q, b + w * q + z * p - x * r, c + w * r + x * q - y * p


def twist_rotated(orientation: Array, twist: Array, *, back: bool = False) -> Array:
    """Rotate the linear part and the angular part of a twist (6), each with `rotated`."""
    return np.array(
        [*rotated(orientation, twist[:3], back=back), *rotated(orientation, twist[3:], back=back)]
    )


def distance(
    position: Array, orientation: Array, other_position: Array, other_orientation: Array
) -> tuple[float, float]:
    """Return the distance [m] and the angle [rad] between two poses.

    The angle is computed from the length of the difference of the two unit quaternions. This method
    is accurate for small angles.
    """
    gap = position - other_position
    q = orientation / math.sqrt(orientation @ orientation)
    r = other_orientation / math.sqrt(other_orientation @ other_orientation)
    chord = q - r if q @ r >= 0.0 else q + r
    return math.sqrt(gap @ gap), 4.0 * math.asin(min(1.0, 0.5 * math.sqrt(chord @ chord)))
