"""Matched discretisation of a spring and damper whose wrench is held for a whole sampling period.

The held wrench F is the mean of the continuous law over the period T. For a mass M under F, the
mean of the velocities at both ends is exactly v_mean = v + T/(2 M) F, and the mean displacement is
x_mean = x + T/2 v_mean. F = -K x_mean - D v_mean is solved in closed form below. Its work over the
period is exactly that of a spring with potential 1/2 x^T K x and of a damper T v_mean^T D v_mean.
Sampling therefore generates no energy, for any K, D and T.
This law is this project's own; docs/matched_gains.md derives it and states its limits.
"""

from __future__ import annotations

from enum import IntEnum

import casadi as ca

from freeflyer_fmus.equations.spatial import solve_positive_definite

SX = ca.SX


class Discretisation(IntEnum):
    """`emulated`: continuous law at the sample, (16), (17). `matched`: its mean over the period."""

    emulated = 1
    matched = 2


def mean_wrench(
    inertia: SX, stiffness: SX, damping: SX, period: SX, spring: SX, velocity_error: SX
) -> SX:
    """Return -K dx_mean - D dx'_mean (6); `spring` is -K dx at the sample.

    Inertia M, K and D are (6, 6) and symmetric. The means solve
    (M + T/2 D + T^2/4 K) dx'_mean = M dx' - T/2 K dx and dx_mean = dx + T/2 dx'_mean.
    As T -> 0 the result tends to the continuous law.
    """
    half = 0.5 * period
    implicit = inertia + half * damping + half**2 * stiffness
    mean_velocity = solve_positive_definite(implicit, inertia @ velocity_error + half * spring)
    return spring - (half * stiffness + damping) @ mean_velocity


def sampled_damping(inertia: SX, stiffness: SX, damping: SX, period: SX) -> SX:
    """Return -dF/dx' (6) of the held wrench, per axis (diagonals, 6 each).

    It is below 2 M / T for any K and D.
    """

    half = 0.5 * period
    return (damping + half * stiffness) * inertia / (inertia + half * damping + half**2 * stiffness)
