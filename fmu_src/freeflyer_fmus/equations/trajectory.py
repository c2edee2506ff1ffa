"""Reference motions of the end-effector: a ramped sine (Fig. 2) and a straight line.

The sine moves the end-effector along a fixed axis of I, and rotates it about a fixed axis of I. The
paper does not give the amplitudes and the frequency. They are parameters, and their defaults are
assumptions.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from freeflyer_fmus.equations import rotation

SX = ca.SX


class Motion(NamedTuple):
    """Pose x_md, velocity x_md' (6) and acceleration x_md'' (6), in I.

    The pose consists of a position (3) and a quaternion (4).
    """

    position: SX
    orientation: SX
    velocity: SX
    acceleration: SX


def quintic_ramp(t: SX, duration: SX) -> tuple[SX, SX, SX]:
    """Return the value and the first two derivatives of a ramp from 0 to 1 over `duration` [s].

    The ramp is twice continuously differentiable.
    """
    s = ca.fmin(ca.fmax(t / duration, 0.0), 1.0)
    value = s**3 * (10.0 + s * (-15.0 + 6.0 * s))
    first = 30.0 * s**2 * (1.0 - s) ** 2 / duration
    second = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / duration**2
    return value, first, second


def ramped_sine(
    t: SX,
    position: SX,
    orientation: SX,
    translation: SX,
    rotation_vector: SX,
    frequency: SX,
    ramp_time: SX,
) -> Motion:
    """Return the motion x_md = x_0 + translation g, R_md = Exp(rotation_vector g) R_0.

    The factor g is ramp(t / ramp_time) sin(2 pi f t). f is `frequency` [Hz]. x_0 and R_0 are the
    start pose, given by `position` and `orientation`. `translation` (3) [m] and `rotation_vector`
    (3) [rad] are the amplitudes, in I. The rotation axis is fixed. Therefore the angular velocity
    is exactly rotation_vector g'.
    """
    r, rd, rdd = quintic_ramp(t, ramp_time)
    omega = 2.0 * ca.pi * frequency
    s, c = ca.sin(omega * t), ca.cos(omega * t)
    g, gd = r * s, rd * s + r * omega * c
    gdd = rdd * s + 2.0 * rd * omega * c - r * omega**2 * s
    amplitude = ca.vertcat(translation, rotation_vector)
    return Motion(
        position + translation * g,
        rotation.product(rotation.about(rotation_vector * g), rotation.normalised(orientation)),
        amplitude * gd,
        amplitude * gdd,
    )


def straight_line(t: SX, position: SX, orientation: SX, displacement: SX, duration: SX) -> Motion:
    """Return the motion x_md = x_0 + displacement ramp(t / duration). The orientation is constant.

    x_0 is `position`. The motion starts and ends at rest. The paper gives the line and the duration
    in Sec. VI. The profile ramp(t / duration) along the line is an assumption (`quintic_ramp`).
    """
    s, sd, sdd = quintic_ramp(t, duration)
    still = SX(3, 1)
    return Motion(
        position + displacement * s,
        rotation.normalised(orientation),
        ca.vertcat(displacement * sd, still),
        ca.vertcat(displacement * sdd, still),
    )
