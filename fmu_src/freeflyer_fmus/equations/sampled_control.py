"""A spring and damper whose wrench is held for a whole period: what is held is the mean of what it should be until the next sample.

Over a period T of a mass M under the held wrench F the mean of the velocities at both ends is exactly v + T/(2 M) F, and that of the
displacements x + T/2 of that. A law that is taken at these means, -K x_mean - D v_mean, instead of at the sample, is solved for F in
closed form below. Its work over the period is exactly that of a spring with potential 1/2 x^T K x and a damper T v_mean^T D v_mean: no
energy comes from sampling, whatever K, D and T. (This project's own; derived, with its limits, in docs/matched_gains.md.)
"""

from __future__ import annotations

from enum import IntEnum

import casadi as ca

from freeflyer_fmus.equations.spatial import solve_positive_definite

SX = ca.SX


class Discretisation(IntEnum):
    """`emulated`: the continuous law at the sample, (16) and (17). `matched`: its mean over the period that it is held for."""

    emulated = 1
    matched = 2


def mean_wrench(
    inertia: SX, stiffness: SX, damping: SX, period: SX, spring: SX, velocity_error: SX
) -> SX:
    """-K dx_mean - D dx'_mean (6), where `spring` is -K dx of the sample; inertia M (6, 6), K and D (6, 6), symmetric.

    (M + T/2 D + T^2/4 K) dx'_mean = M dx' - T/2 K dx,  dx_mean = dx + T/2 dx'_mean. As T -> 0 it is the continuous law.
    """
    half = 0.5 * period
    implicit = inertia + half * damping + half**2 * stiffness
    mean_velocity = solve_positive_definite(implicit, inertia @ velocity_error + half * spring)
    return spring - (half * stiffness + damping) @ mean_velocity


def sampled_damping(inertia: SX, stiffness: SX, damping: SX, period: SX) -> SX:
    """-dF/dx' (6) of the held wrench, axis by axis (diagonals, 6 each): below 2 M / T whatever K and D."""
    half = 0.5 * period
    return (damping + half * stiffness) * inertia / (inertia + half * damping + half**2 * stiffness)
