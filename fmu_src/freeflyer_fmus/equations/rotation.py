"""Unit quaternions [x, y, z, w], and the orientation error of the paper."""

from __future__ import annotations

import casadi as ca

SX = ca.SX


def product(a: SX, b: SX) -> SX:
    """Return the Hamilton product a * b of quaternions [x, y, z, w]."""
    av, aw, bv, bw = a[:3], a[3], b[:3], b[3]
    return ca.vertcat(aw * bv + bw * av + ca.cross(av, bv), aw * bw - ca.dot(av, bv))


def conjugate(a: SX) -> SX:
    return ca.vertcat(-a[:3], a[3])


def normalised(a: SX) -> SX:
    return a / ca.sqrt(ca.dot(a, a))


def matrix(a: SX) -> SX:
    """Return the rotation matrix (3, 3) of a quaternion. The quaternion need not be normalised."""
    x, y, z, w = ca.vertsplit(a)
    s = 2.0 / ca.dot(a, a)
    return ca.blockcat(
        [
            [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
            [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
            [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
        ]
    )


def derivative(a: SX, w: SX) -> SX:
    """Return da/dt for the angular velocity w (3) in I. The norm of a stays constant."""
    return 0.5 * product(ca.vertcat(w, 0), a)


def error(actual: SX, desired: SX) -> SX:
    """Return the orientation error 2 eps (3), expressed in I.

    eps is the vector part of the error quaternion actual * desired^-1. A quaternion and its
    negative describe the same orientation. The quaternion with a scalar part >= 0 is used, so that
    the angle is at most 180 degrees. 2 eps is the orientation part of Delta x in (7) and (8). For a
    stiffness k that is equal about all axes, the torque -2 k eps has a potential energy. 2 eps
    differs from the rotation vector only by terms of third order in the angle.
    """
    e = normalised(product(actual, conjugate(desired)))
    return 2.0 * ca.if_else(e[3] < 0, -1.0, 1.0) * e[:3]


def about(vector: SX) -> SX:
    """Return the quaternion of a rotation vector (3) [rad]. The vector may be zero."""
    # The derivative of a square root is infinite at zero. The addend 1e-300 keeps the derivative
    # finite. The addend does not change the result.
    half = 0.5 * ca.sqrt(ca.dot(vector, vector) + 1e-300)
    # `ratio` is sin(h) / h, where h is half of the angle. For h < 1e-4, the first two terms of the
    # power series are exact to the last bit, and they need no division by h.
    small = half < 1e-4
    safe = ca.if_else(small, 1.0, half)
    ratio = ca.if_else(small, 1.0 - half * half / 6.0, ca.sin(safe) / safe)
    return ca.vertcat(0.5 * ratio * vector, ca.cos(half))


def about_z(angle: SX) -> SX:
    """Return the quaternion of a rotation about z by `angle` [rad]."""
    return ca.vertcat(0, 0, ca.sin(0.5 * angle), ca.cos(0.5 * angle))
