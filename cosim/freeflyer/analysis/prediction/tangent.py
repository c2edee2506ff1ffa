"""Tangent chart of a unit quaternion.

The chart describes a small rotation by three independent coordinates: the rotation vector.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from freeflyer.fmi.component import Array


def from_rotation(quaternion: Array) -> Array:
    """Return dq/dd (4, 3), the derivative of a quaternion q with respect to a rotation vector d.

    q is [x, y, z, w]. d is a small rotation in the inertial frame I. The derivative follows from
    dq = 1/2 (d, 0) q.
    """
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return 0.5 * np.array([[w, z, -y], [-z, w, x], [y, -x, w], [-x, -y, -z]])


def to_rotation(quaternion: Array) -> Array:
    """Return dd/dq (3, 4), the inverse of the map dq/dd.

    The map ignores the part of a change dq that only changes the length of the quaternion.
    """
    return 4.0 * from_rotation(quaternion).T


def chart(
    names: Sequence[str], values: Sequence[Array], quaternions: frozenset[str]
) -> tuple[Array, Array]:
    """Return the map (m, n) from chart coordinates to changes of the variables, and its inverse.

    `names` and `values` are the variables. Their elements are concatenated, m in total.
    `quaternions` contains the names of those variables that are quaternions. The coordinates (n)
    have a rotation vector in place of each quaternion. Therefore the coordinates are independent.
    """
    rotational = [name in quaternions for name in names]
    out = [
        from_rotation(value) if r else np.eye(value.size)
        for r, value in zip(rotational, values, strict=True)
    ]
    back = [
        to_rotation(value) if r else np.eye(value.size)
        for r, value in zip(rotational, values, strict=True)
    ]
    return block_diag(*out), block_diag(*back)
