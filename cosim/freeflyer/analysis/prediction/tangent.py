"""Small rotations as three coordinates: the tangent chart of a unit quaternion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from freeflyer.fmi.component import Array


def from_rotation(quaternion: Array) -> Array:
    """(4, 3): change of the quaternion [x, y, z, w] by a small rotation vector in I, dq = 1/2 (d, 0) q."""
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return 0.5 * np.array([[w, z, -y], [-z, w, x], [y, -x, w], [-x, -y, -z]])


def to_rotation(quaternion: Array) -> Array:
    """(3, 4): the rotation vector in I of a small change of the quaternion; a change of its length has none."""
    return 4.0 * from_rotation(quaternion).T


def chart(
    names: Sequence[str], values: Sequence[Array], quaternions: frozenset[str]
) -> tuple[Array, Array]:
    """Small changes of these variables, one after the other, from coordinates without a constraint (a rotation vector in place
    of every quaternion), and the way back: (m, n) and (n, m).
    """
    turned = [name in quaternions for name in names]
    out = [
        from_rotation(value) if t else np.eye(value.size)
        for t, value in zip(turned, values, strict=True)
    ]
    back = [
        to_rotation(value) if t else np.eye(value.size)
        for t, value in zip(turned, values, strict=True)
    ]
    return block_diag(*out), block_diag(*back)
