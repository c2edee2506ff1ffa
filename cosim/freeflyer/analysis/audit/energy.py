"""Energy of wrenches that are held on a moving body, and of the spring-damper that they emulate.

All functions are pure. Arrays have one row per instant (n), or per interval between instants
(n - 1). 6-vectors are [linear; angular] in I; quaternions are [x, y, z, w]. SI units.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from freeflyer.fmi.component import Array


def at_base(wrench: Array, lever: Array) -> Array:
    """Return J_b^T F (n, 6), an end-effector wrench (n, 6) at B: [f; p x f + torque], from (2).

    `lever` (n, 3) is p = p_e - p_b.
    """
    return np.hstack([wrench[:, :3], np.cross(lever, wrench[:, :3]) + wrench[:, 3:]])


def pose_error(
    position: Array, orientation: Array, desired_position: Array, desired_orientation: Array
) -> Array:
    """Return Delta x (n, 6) of (7) and (8), from positions (n, 3) and quaternions (n, 4).

    The rotational part is twice the vector part of the error quaternion with eta >= 0.
    """
    relative = Rotation.from_quat(orientation) * Rotation.from_quat(desired_orientation).inv()
    return np.hstack([position - desired_position, 2.0 * relative.as_quat(canonical=True)[:, :3]])


def displacement(time: Array, position: Array, orientation: Array, velocity: Array) -> Array:
    """Return the integral of x' (n - 1, 6) over each interval, from poses and twists (n, 6).

    The integral of the angular velocity has no closed form. The rotation vector of R(k+1) R(k)^T
    is the first term of its Magnus series. With the second term the error is of fifth order in
    the interval (Iserles et al., Acta Numerica 2000).
    """
    T = np.diff(time)[:, None]
    rotation_vector = (
        Rotation.from_quat(orientation[1:]) * Rotation.from_quat(orientation[:-1]).inv()
    ).as_rotvec()
    w = velocity[:, 3:]
    w_integral = rotation_vector + T**2 / 12.0 * np.cross(w[:-1], w[1:])
    return np.hstack([np.diff(position, axis=0), w_integral])


def displacement_of_twist(time: Array, velocity: Array) -> Array:
    """Return the integral of x' (n - 1, 6) by the trapezoidal rule, which the observers use too.

    For measured motion: differences of noisy poses would be worse.
    """
    return 0.5 * np.diff(time)[:, None] * (velocity[:-1] + velocity[1:])


def held(values: Array, share: float) -> Array:
    """Return the mean (n - 1, m) over each interval of a sampled and held signal (n, m).

    `share` is the hold time divided by the interval. With share = 1 the mean is the value at the
    start of the interval. With share < 1 the samples inside the interval are assumed to lie on a
    line; their mean is then (1 + share)/2 F(k) + (1 - share)/2 F(k+1).
    """
    return 0.5 * (1.0 + share) * values[:-1] + 0.5 * (1.0 - share) * values[1:]


def last_samples(time: Array, values: Array, period: int) -> Array:
    """Return `values` (n, m) at the last sample of a controller with this period [ns] from t = 0.

    Interpolates linearly if a sample lies between two rows.
    """
    instants = np.rint(time * 1e9).astype(np.int64)
    sampled = (instants - instants % period) * 1e-9
    return np.column_stack([np.interp(sampled, time, column) for column in values.T])


def summed(intervals: Array) -> Array:
    """Return the cumulative sum (n, ...) of interval values (n - 1, ...); 0 at the first row."""
    return np.concatenate([np.zeros((1, *intervals.shape[1:])), np.cumsum(intervals, axis=0)])


def work(force: Array, moved: Array) -> Array:
    """Return W(k) (n, m) per degree of freedom: the sum of F (x(j+1) - x(j)) up to k.

    Exact for a held force (Stramigioli et al., T-RO 2005).
    """
    return summed(force * moved)


def spring_energy(stiffness: Array, error: Array) -> Array:
    """Return U (n, 6), the potential of -K_P Delta x, for isotropic rotational stiffness.

    Translation: 1/2 k dx^2. Rotation, with Delta x = 2 eps: the torque -2 k eps has the potential
    4 k (1 - eta) = k |2 eps|^2 / (1 + eta).
    """
    two_eps = error[:, 3:]
    eta = np.sqrt(np.maximum(1.0 - 0.25 * np.sum(two_eps**2, axis=1, keepdims=True), 0.0))
    return np.hstack(
        [0.5 * stiffness[:3] * error[:, :3] ** 2, stiffness[3:] * two_eps**2 / (1.0 + eta)]
    )


def dissipation(time: Array, damping: Array, velocity: Array) -> Array:
    """Return D(k) (n, m), the integral of K_D v^2, with velocities linear between the rows."""
    before, after = velocity[:-1], velocity[1:]
    return summed(damping * np.diff(time)[:, None] / 3.0 * (before**2 + before * after + after**2))


def virtual_energy(worked: Array, stored: Array, dissipated: Array) -> Array:
    """Return V = W + U - U(0) + D (n, m), the energy that a held spring-damper generates.

    It is the work beyond that of the continuous spring-damper on the same motion, which is
    -(U - U(0)) - D. A held spring on one axis generates K/2 (x(k+1) - x(k))^2 per hold.
    """
    return np.asarray(worked + stored - stored[0] + dissipated)
