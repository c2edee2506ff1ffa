"""A smooth motion through waypoints: a quintic spline that is twice continuously differentiable.

At an inner waypoint, velocity and acceleration are those of the parabola through this waypoint and
its two neighbours. At the first and the last waypoint both are zero. Between two waypoints, the
motion is the quintic polynomial with these values at its ends. Therefore a point of the motion
depends on only four waypoints, and no system of equations has to be solved.
"""

from __future__ import annotations

import casadi as ca

from freeflyer_fmus.equations import rotation
from freeflyer_fmus.equations.trajectory import Motion

SX = ca.SX


UNUSED = -1.0
"""Time of an unused waypoint."""


def used(times: SX) -> list[SX]:
    """Return for each waypoint whether it is used (1 or 0).

    `times` (n) [s] are the times of the waypoints. They increase. The unused waypoints at the end
    have the time UNUSED. The first waypoint always counts as used.
    """
    flags = [SX(1)]
    for before, after in zip(ca.vertsplit(times)[:-1], ca.vertsplit(times)[1:], strict=True):
        flags.append(flags[-1] * (after > before))
    return flags


def order_margin(times: SX, points: SX) -> SX:
    """Return a number that is positive if the times of the waypoints are valid.

    The used times must increase, and all other times must be UNUSED. If no time is given, all
    displacements in `points` (n, 7) must be 0.
    """
    flags, parts = used(times), ca.vertsplit(times)
    margin = ca.if_else(parts[0] == UNUSED, -ca.sumsqr(points[:, :3]) + 1e-300, 1.0)
    for k in range(1, len(parts)):
        step = ca.if_else(flags[k - 1] > 0, parts[k] - ca.fmax(parts[k - 1], 0.0), -1.0)
        step = ca.if_else(parts[k - 1] == UNUSED, -1.0, step)
        margin = ca.fmin(margin, ca.if_else(parts[k] == UNUSED, 1.0, step))
    return margin


def through(t: SX, times: SX, points: SX) -> tuple[SX, SX, SX]:
    """Return the spline at time t [s], with its first and second derivative (columns each).

    `times` (n) are as in `used`. `points` (n, columns) are the waypoints. The last 4 columns are
    quaternions. Each quaternion may have either sign. Before the first and after the last waypoint,
    the result is constant.
    """
    flags, parts = used(times), ca.vertsplit(times)
    n = len(parts)
    # `place` is the number k of the interval from waypoint k to waypoint k + 1 that contains t. The
    # last interval also contains all later times.
    place = SX(0)
    for k in range(1, n - 1):
        place += flags[k + 1] * (t >= parts[k])
    table = ca.horzcat(times, points, ca.vertcat(*flags))

    def neighbour(offset: int) -> tuple[SX, SX, SX]:
        """Return time, point and `used` of waypoint k + offset. Outside the list, all are 0."""
        row = SX(1, table.shape[1])
        for k in range(n):
            if 0 <= k + offset < n:
                row += ca.if_else(place == k, table[k + offset, :], 0.0)
        return row[0], row[1:-1].T, row[-1]

    (t_0, x_0, _), (t_1, x_1, present_1) = neighbour(0), neighbour(1)
    (t_a, x_a, present_a), (t_b, x_b, present_b) = neighbour(-1), neighbour(2)
    # Make the signs of the quaternions equal. With a single waypoint, the motion rests there.
    x_1 = _same_sign(ca.if_else(present_1 > 0, x_1, x_0), x_0)
    x_a, x_b = _same_sign(x_a, x_0), _same_sign(x_b, x_1)
    h = ca.if_else(present_1 > 0, t_1 - t_0, 1.0)
    v_0, a_0 = _parabola(ca.if_else(present_a > 0, t_0 - t_a, 1.0), h, x_a, x_0, x_1)
    v_1, a_1 = _parabola(h, ca.if_else(present_b > 0, t_b - t_1, 1.0), x_0, x_1, x_b)
    v_0, a_0 = (ca.if_else(present_a > 0, part, 0.0) for part in (v_0, a_0))
    v_1, a_1 = (ca.if_else(present_b > 0, part, 0.0) for part in (v_1, a_1))

    # Quintic polynomial x_0 + h v_0 s + h^2 a_0 s^2 / 2 + c_3 s^3 + c_4 s^4 + c_5 s^5.
    s = ca.fmin(ca.fmax((t - t_0) / h, 0.0), 1.0)
    moving = ca.logic_and(t > t_0, t < t_0 + h)
    u_0, u_1, w_0, w_1 = h * v_0, h * v_1, h**2 * a_0, h**2 * a_1
    d = x_1 - x_0
    c_3 = 10.0 * d - 6.0 * u_0 - 4.0 * u_1 - 1.5 * w_0 + 0.5 * w_1
    c_4 = -15.0 * d + 8.0 * u_0 + 7.0 * u_1 + 1.5 * w_0 - w_1
    c_5 = 6.0 * d - 3.0 * (u_0 + u_1) - 0.5 * w_0 + 0.5 * w_1
    x = x_0 + s * (u_0 + s * (0.5 * w_0 + s * (c_3 + s * (c_4 + s * c_5))))
    v = (u_0 + s * (w_0 + s * (3.0 * c_3 + s * (4.0 * c_4 + s * 5.0 * c_5)))) / h
    a = (w_0 + s * (6.0 * c_3 + s * (12.0 * c_4 + s * 20.0 * c_5))) / h**2
    return x, ca.if_else(moving, v, 0.0), ca.if_else(moving, a, 0.0)


def motion(t: SX, times: SX, points: SX, position: SX, orientation: SX) -> Motion:
    """Return the motion through waypoints that are relative to a start pose.

    A row of `points` (n, 7) is a displacement [m] and a rotation (quaternion, not zero), in I.
    `position` (3) [m] and `orientation` (quaternion) are the start pose.
    """
    x, xd, xdd = through(t, times, points)
    q, qd, qdd = x[3:], xd[3:], xdd[3:]
    # Angular velocity and acceleration of the normalised quaternion: w = 2 vec(q' q^-1).
    norm = ca.dot(q, q)
    w = 2.0 * rotation.product(qd, rotation.conjugate(q))[:3] / norm
    wd = 2.0 * rotation.product(qdd, rotation.conjugate(q))[:3] / norm
    wd -= 2.0 * ca.dot(q, qd) / norm * w
    return Motion(
        position + x[:3],
        rotation.product(rotation.normalised(q), rotation.normalised(orientation)),
        ca.vertcat(xd[:3], w),
        ca.vertcat(xdd[:3], wd),
    )


def _same_sign(x: SX, reference: SX) -> SX:
    """Return x with the sign of its quaternion changed, if that brings it closer to `reference`."""
    sign = ca.if_else(ca.dot(x[-4:], reference[-4:]) < 0.0, -1.0, 1.0)
    return ca.vertcat(x[:-4], sign * x[-4:])


def _parabola(before: SX, after: SX, x_a: SX, x: SX, x_b: SX) -> tuple[SX, SX]:
    """Return velocity and acceleration at x of the parabola through three points.

    `before` and `after` are the durations [s] of the two intervals.
    """
    left, right = (x - x_a) / before, (x_b - x) / after
    acceleration = 2.0 * (right - left) / (before + after)
    return left + 0.5 * before * acceleration, acceleration
