"""Matched discretisation of a spring and damper whose wrench is held for a whole sampling period.

The continuous law is F = -K x - D v, with the stiffness K and the damping D. The held wrench F is
the mean of this law over the period T. F accelerates a mass M, which has the displacement x and the
velocity v at the start of the period. The mean of the velocities at the start and at the end of the
period is exactly v_mean = v + T/(2 M) F. The mean of the displacements at the start and at the end
is x_mean = x + T/2 v_mean. `mean_wrench` solves the equation F = -K x_mean - D v_mean in closed
form. The work of F over the period has exactly two parts. One part is the work of a spring with the
potential 1/2 x^T K x. The other part is the work -T v_mean^T D v_mean of a damper, which only
dissipates energy. Therefore sampling does not generate energy for any K, D and T, if M is constant.
In I, the inertia of a rotating body is not constant. There the law can generate energy.

The law is not in the paper. docs/matched_gains.md derives the law and states its limits.
"""

from __future__ import annotations

from enum import IntEnum

import casadi as ca

from freeflyer_fmus.equations.spatial import solve_positive_definite

SX = ca.SX


class Discretisation(IntEnum):
    """How a continuous control law is sampled.

    `emulated`: the held wrench is the value of the law at the sample, as in (16) and (17).
    `matched`: the held wrench is the mean of the law over the period.
    """

    emulated = 1
    matched = 2


def mean_wrench(
    inertia: SX,
    stiffness: SX,
    damping: SX,
    period: SX,
    spring: SX,
    velocity_error: SX,
    theta: SX | float = 0.5,
) -> SX:
    """Return the held wrench -K dx_mean - D dx'_mean (6).

    dx is the pose error. `spring` is -K dx at the sample, and `velocity_error` is dx' at the
    sample. The inertia M, the stiffness K and the damping D are (6, 6) and symmetric. `period` is
    T. The means are the solution of
    (M + T' D + T'^2 K) dx'_mean = M dx' - T' K dx and dx_mean = dx + T' dx'_mean with T' = theta T.
    theta = 1/2 gives the mean over the period. A larger theta gives a value from later in the
    period: it dissipates energy, also where the premises of the mean law do not hold.
    As T -> 0 the result tends to the continuous law.
    """
    half = theta * period
    mean = _mean_velocity(inertia, stiffness, damping, half, spring, velocity_error)
    return spring - (half * stiffness + damping) @ mean


def mean_step(
    inertia: SX, stiffness: SX, damping: SX, period: SX, spring: SX, velocity_error: SX
) -> tuple[SX, SX]:
    """Return the changes of pose error and velocity error (6 each) over one period of the mean law.

    The arguments are those of `mean_wrench` with theta = 1/2. dx+ = dx + T dx'_mean and dx'+ = dx'
    + 2 (dx'_mean - dx').
    """
    mean = _mean_velocity(inertia, stiffness, damping, 0.5 * period, spring, velocity_error)
    return period * mean, 2.0 * (mean - velocity_error)


def _mean_velocity(
    inertia: SX, stiffness: SX, damping: SX, half: SX, spring: SX, velocity_error: SX
) -> SX:
    """Return dx'_mean of `mean_wrench`. `half` is T' = theta T."""
    implicit = inertia + half * damping + half**2 * stiffness
    return solve_positive_definite(implicit, inertia @ velocity_error + half * spring)


def sampled_damping(
    inertia: SX, stiffness: SX, damping: SX, period: SX, theta: SX | float = 0.5
) -> SX:
    """Return the damping -dF/dx' (6) of each axis, for the held wrench F of `mean_wrench`.

    The inertia M, the stiffness K and the damping D are given as diagonals (6 each). The result is
    below M / (theta T), for any K and D.
    """
    half = theta * period
    return (damping + half * stiffness) * inertia / (inertia + half * damping + half**2 * stiffness)
