"""Energy of wrenches held on a moving body, and of the spring and damper that they stand for; arrays in, arrays out.

Rows are instants, n of them; what belongs to the interval that begins at a row has n - 1 rows. Every 6-vector is
[linear; angular] in I; quaternions are [x, y, z, w]. SI units.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from freeflyer.fmi.component import Array


def at_base(wrench: Array, arm: Array) -> Array:
    """J_b^T F (n, 6): a wrench at the hand, felt at B; `arm` (n, 3) is p_e - p_b. [F; p x F + torque], from (2)."""
    return np.hstack([wrench[:, :3], np.cross(arm, wrench[:, :3]) + wrench[:, 3:]])


def pose_error(
    position: Array, orientation: Array, desired_position: Array, desired_orientation: Array
) -> Array:
    """Delta x (n, 6) of (7) and (8): position error and twice the vector part of the error quaternion, the shorter way round."""
    relative = Rotation.from_quat(orientation) * Rotation.from_quat(desired_orientation).inv()
    return np.hstack([position - desired_position, 2.0 * relative.as_quat(canonical=True)[:, :3]])


def displacement(time: Array, position: Array, orientation: Array, velocity: Array) -> Array:
    """Integral of x' (n - 1, 6) over every interval: the difference of positions, and the integral of the angular velocity.

    The latter is no difference of anything. The rotation vector of R(k+1) R(k)^T is the first term of its Magnus series; the
    second is added here, so that the error is of the fifth order in the interval (Iserles et al., Acta Numerica 2000).
    """
    T = np.diff(time)[:, None]
    turn = (
        Rotation.from_quat(orientation[1:]) * Rotation.from_quat(orientation[:-1]).inv()
    ).as_rotvec()
    w = velocity[:, 3:]
    return np.hstack([np.diff(position, axis=0), turn + T**2 / 12.0 * np.cross(w[:-1], w[1:])])


def displacement_of_twist(time: Array, velocity: Array) -> Array:
    """Integral of x' (n - 1, 6) by the trapezoid, for a motion that is measured with noise: as the observers take it."""
    return 0.5 * np.diff(time)[:, None] * (velocity[:-1] + velocity[1:])


def held(values: Array, share: float) -> Array:
    """Mean (n - 1, m) over every interval of what is sampled once per `share` of it and held, from its values at the rows.

    A whole share: the value at the interval's begin, exactly. Less: the samples in between are taken to lie on a line, whose
    mean of samples, each held for its time, is (1 + share)/2 F(k) + (1 - share)/2 F(k+1).
    """
    return 0.5 * (1.0 + share) * values[:-1] + 0.5 * (1.0 - share) * values[1:]


def last_samples(time: Array, values: Array, period: int) -> Array:
    """(n, m): what `values` were when a controller of this period [ns], which began at t = 0, last took a sample.

    Linear in between, where a sample falls between two rows.
    """
    instants = np.rint(time * 1e9).astype(np.int64)
    sampled = (instants - instants % period) * 1e-9
    return np.column_stack([np.interp(sampled, time, column) for column in values.T])


def summed(intervals: Array) -> Array:
    """(n, ...): the sum up to every row, from what belongs to the intervals; 0 at the first row."""
    return np.concatenate([np.zeros((1, *intervals.shape[1:])), np.cumsum(intervals, axis=0)])


def work(force: Array, moved: Array) -> Array:
    """W(k) (n, m), degree of freedom by degree of freedom: the sum of F (x(j+1) - x(j)) up to k.

    Exact for a held force (Stramigioli et al., T-RO 2005).
    """
    return summed(force * moved)


def spring_energy(stiffness: Array, error: Array) -> Array:
    """U (n, 6): the potential of -K_P Delta x, for isotropic rotational stiffness. 1/2 k dx^2; for the rotation, where Delta x
    is 2 eps, the torque -2 k eps derives from 4 k (1 - eta) = k |2 eps|^2 / (1 + eta).
    """
    turn = error[:, 3:]
    eta = np.sqrt(np.maximum(1.0 - 0.25 * np.sum(turn**2, axis=1, keepdims=True), 0.0))
    return np.hstack(
        [0.5 * stiffness[:3] * error[:, :3] ** 2, stiffness[3:] * turn**2 / (1.0 + eta)]
    )


def dissipation(time: Array, damping: Array, velocity: Array) -> Array:
    """D(k) (n, m): the integral of K_D v^2, for velocities that are linear between the rows."""
    before, after = velocity[:-1], velocity[1:]
    return summed(damping * np.diff(time)[:, None] / 3.0 * (before**2 + before * after + after**2))


def virtual_energy(worked: Array, stored: Array, dissipated: Array) -> Array:
    """What a held spring-damper has given beyond the continuous one on the same motion: V = W + U - U(0) + D (n, m).

    The continuous one's work is -(U - U(0)) - D. For a held spring on an axis V is K/2 (x(k+1) - x(k))^2 per hold.
    """
    return np.asarray(worked + stored - stored[0] + dissipated)
