"""The end-effector's reference motion (Fig. 2): a ramped sine along and about fixed axes of I.

The paper's text gives neither amplitudes nor frequency: they are parameters, and their defaults are this project's own.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from freeflyer_fmus.equations import rotation

SX = ca.SX


class Motion(NamedTuple):
    """x_md as position (3) and quaternion (4), x_md' (6), x_md'' (6); in I."""

    position: SX
    orientation: SX
    velocity: SX
    acceleration: SX


def quintic_ramp(t: SX, duration: SX) -> tuple[SX, SX, SX]:
    """0 to 1 over `duration` [s] with two continuous derivatives: the value and both derivatives."""
    s = ca.fmin(ca.fmax(t / duration, 0.0), 1.0)
    value = s**3 * (10.0 + s * (-15.0 + 6.0 * s))
    first = 30.0 * s**2 * (1.0 - s) ** 2 / duration
    second = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / duration**2
    return value, first, second


def ramped_sine(
    t: SX, position: SX, orientation: SX, translation: SX, turn: SX, frequency: SX, ramp_time: SX
) -> Motion:
    """x_md = x_0 + translation g, R_md = Exp(turn g) R_0 with g = ramp(t / ramp_time) sin(2 pi f t).

    `translation` (3) [m], `turn` (3) rotation vector [rad], both in I; the axis is fixed, so w = turn g' exactly.
    """
    r, rd, rdd = quintic_ramp(t, ramp_time)
    omega = 2.0 * ca.pi * frequency
    s, c = ca.sin(omega * t), ca.cos(omega * t)
    g, gd = r * s, rd * s + r * omega * c
    gdd = rdd * s + 2.0 * rd * omega * c - r * omega**2 * s
    amplitude = ca.vertcat(translation, turn)
    return Motion(
        position + translation * g,
        rotation.product(rotation.about(turn * g), rotation.normalised(orientation)),
        amplitude * gd,
        amplitude * gdd,
    )


def straight_line(t: SX, position: SX, orientation: SX, displacement: SX, duration: SX) -> Motion:
    """x_md = x_0 + displacement ramp(t / duration): a straight line at rest at both ends, the orientation kept.

    The paper's Sec. VI gives line and duration; the quintic course along it is this project's assumption.
    """
    s, sd, sdd = quintic_ramp(t, duration)
    still = SX(3, 1)
    return Motion(
        position + displacement * s,
        rotation.normalised(orientation),
        ca.vertcat(displacement * sd, still),
        ca.vertcat(displacement * sdd, still),
    )
