"""Energy of a sampled and held control law, and of the continuous spring-damper that it replaces.

A held wrench is constant between two samples of its controller. An instant is the time of one row
of the record. Arrays have one row for each instant (n), or one row for each interval between two
instants (n - 1). 6-vectors are [linear; angular] in the inertial frame I. Quaternions are
[x, y, z, w]. All values are in SI units. Single numbers in parentheses, for example (7), are
equations of the paper.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from freeflyer.fmi.component import Array


def at_base(wrench: Array, lever: Array) -> Array:
    """Return J_b^T F (n, 6), the wrench at B that is equivalent to an end-effector wrench (n, 6).

    The result is [f; p x f + torque], from (2). f is the force of the wrench. `lever` (n, 3) is p,
    the position of the end-effector minus the position of the base.
    """
    return np.hstack([wrench[:, :3], np.cross(lever, wrench[:, :3]) + wrench[:, 3:]])


def pose_error(
    position: Array, orientation: Array, desired_position: Array, desired_orientation: Array
) -> Array:
    """Return Delta x (n, 6) of (7) and (8), from positions (n, 3) and quaternions (n, 4).

    The rotational part is twice the vector part of the error quaternion. The sign of the quaternion
    is chosen so that its scalar part eta is >= 0.
    """
    relative = Rotation.from_quat(orientation) * Rotation.from_quat(desired_orientation).inv()
    return np.hstack([position - desired_position, 2.0 * relative.as_quat(canonical=True)[:, :3]])


def displacement(time: Array, position: Array, orientation: Array, velocity: Array) -> Array:
    """Return the integral (n - 1, 6) of the velocity x' over each interval.

    The arguments have one row for each instant. `velocity` (n, 6) is x'. The linear part of the
    result is the difference of the positions. The integral of the angular velocity cannot be
    computed exactly from the orientations. It is computed with two terms of a Magnus series. The
    first term is the rotation vector of R(k+1) R(k)^T. With the second term, the error is of fifth
    order in the interval (Iserles et al., Acta Numerica 2000).
    """
    T = np.diff(time)[:, None]
    rotation_vector = (
        Rotation.from_quat(orientation[1:]) * Rotation.from_quat(orientation[:-1]).inv()
    ).as_rotvec()
    w = velocity[:, 3:]
    w_integral = rotation_vector + T**2 / 12.0 * np.cross(w[:-1], w[1:])
    return np.hstack([np.diff(position, axis=0), w_integral])


def displacement_of_twist(time: Array, velocity: Array) -> Array:
    """Return the integral (n - 1, 6) of the velocity x' over each interval.

    The integral is computed by the trapezoidal rule. This function is for measured motion. Measured
    poses contain noise. Therefore their differences would be less accurate than this integral. The
    passivity observers also use the trapezoidal rule.
    """
    return 0.5 * np.diff(time)[:, None] * (velocity[:-1] + velocity[1:])


def held(values: Array, share: float, *, sampled_at_end: bool = True) -> Array:
    """Return the mean of a sampled and held signal (n, m) over each interval.

    The result is (n - 1, m). `share` is the time for which one sample is held, divided by the
    interval. If `share` is 1, the mean is the value at the start of the interval. If `share` is
    less than 1, the interval contains samples that are not in the record. These samples are assumed
    to lie on a line between the two rows. The mean is then
    (1 + share)/2 F(k) + (1 - share)/2 F(k+1). If `sampled_at_end` is False, the last row has the
    last sample before its time. The mean of the last interval is then (F(k) + F(k+1))/2.
    """
    mean = 0.5 * (1.0 + share) * values[:-1] + 0.5 * (1.0 - share) * values[1:]
    if share < 1.0 and not sampled_at_end:
        mean[-1] = 0.5 * (values[-2] + values[-1])
    return mean


def last_samples(time: Array, values: Array, period: int, *, sampled_at_end: bool = True) -> Array:
    """Return for each row the values (n, m) that a controller has sampled last.

    The controller samples every `period` [ns], starting at t = 0. The last sample is at or before
    the time of the row. If `sampled_at_end` is False, that of the last row is before its time. If
    the sample is between two rows, its values are interpolated linearly.
    """
    instants = np.rint(time * 1e9).astype(np.int64)
    if not sampled_at_end:
        instants[-1] -= 1  # ns
    sampled = (instants - instants % period) / 1e9
    return np.column_stack([np.interp(sampled, time, column) for column in values.T])


def summed(intervals: Array) -> Array:
    """Return the cumulative sum (n, ...) of interval values (n - 1, ...).

    The sum is 0 at the first row.
    """
    return np.concatenate([np.zeros((1, *intervals.shape[1:])), np.cumsum(intervals, axis=0)])


def work(force: Array, moved: Array) -> Array:
    """Return the work W(k) (n, m) for each row k and each degree of freedom.

    `force` (n - 1, m) is the force F in each interval, and `moved` (n - 1, m) is the displacement
    x(j+1) - x(j) in interval j. W(k) is the sum of F (x(j+1) - x(j)) over the intervals before row
    k. The sum is exact if the force is constant in each interval (Stramigioli et al., T-RO 2005).
    """
    return summed(force * moved)


def spring_energy(stiffness: Array, error: Array) -> Array:
    """Return U (n, 6), the potential energy of the spring -K_P Delta x for each degree of freedom.

    `error` (n, 6) is Delta x. Each translation has the energy 1/2 k dx^2. [eps; eta] is the error
    quaternion. The rotational part of Delta x is 2 eps, and its torque is -2 k eps. The rotational
    stiffness k is assumed to be isotropic. Then the potential energy of this torque is
    4 k (1 - eta) = k |2 eps|^2 / (1 + eta).
    """
    two_eps = error[:, 3:]
    eta = np.sqrt(np.maximum(1.0 - 0.25 * np.sum(two_eps**2, axis=1, keepdims=True), 0.0))
    return np.hstack(
        [0.5 * stiffness[:3] * error[:, :3] ** 2, stiffness[3:] * two_eps**2 / (1.0 + eta)]
    )


def dissipation(time: Array, damping: Array, velocity: Array) -> Array:
    """Return the dissipated energy D(k) (n, m), the integral of K_D v^2 up to row k.

    The velocity v is assumed to be linear between two rows.
    """
    before, after = velocity[:-1], velocity[1:]
    return summed(damping * np.diff(time)[:, None] / 3.0 * (before**2 + before * after + after**2))


def virtual_energy(worked: Array, stored: Array, dissipated: Array) -> Array:
    """Return V = W + U - U(0) + D (n, m), the energy that a held spring-damper generates.

    `worked` is W, the work of the held spring-damper. `stored` is U, and `dissipated` is D. On the
    same motion, a continuous spring-damper would do the work -(U - U(0)) - D. V is W minus this
    work. For example, a held spring on one axis generates K/2 (x(k+1) - x(k))^2 between two
    samples.
    """
    return np.asarray(worked + stored - stored[0] + dissipated)
