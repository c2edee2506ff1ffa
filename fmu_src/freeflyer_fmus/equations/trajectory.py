"""Reference motions of the end-effector.

The paper shows a sine (Fig. 2) and a straight line (Sec. VI). It gives neither the amplitudes nor
the frequency. They are parameters, and their defaults are assumptions.
"""

from __future__ import annotations

from enum import IntEnum
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


class Shape(IntEnum):
    """Path of the desired motion. r(t) is the quintic ramp from 0 to 1 over the ramp time.

    f(t) falls from 1 to 0 during the fade-out, and w = 2 pi `frequency`.
    """

    # The factor of both amplitudes is r(t) f(t) sin(w t).
    sine = 1
    # The factor is 0: the end-effector stays at the start pose.
    hold = 2
    # The factor is r(t): a straight line to the amplitude, then rest. There is no fade-out.
    line = 3
    # As `sine`. In addition, the second amplitude has the factor r(t) f(t) (1 - cos(w t)). The path
    # is a circle through the start if both translation amplitudes are perpendicular and equally
    # long.
    circle = 4


class Scalar(NamedTuple):
    """A function of time with its first two derivatives."""

    value: SX
    first: SX
    second: SX

    def times(self, other: Scalar) -> Scalar:
        return Scalar(
            self.value * other.value,
            self.first * other.value + self.value * other.first,
            self.second * other.value + 2.0 * self.first * other.first + self.value * other.second,
        )


def fade_out(t: SX, start: SX, duration: SX) -> Scalar:
    """Return 1 - quintic_ramp: 1 until `start` [s], and 0 from `start` + `duration` [s] on."""
    value, first, second = quintic_ramp(t - start, duration)
    return Scalar(1.0 - value, -first, -second)


def along(
    t: SX,
    shape: SX,
    position: SX,
    orientation: SX,
    translation: SX,
    second_translation: SX,
    rotation_vector: SX,
    frequency: SX,
    ramp_time: SX,
    fade: Scalar,
) -> Motion:
    """Return the motion x_md = x_0 + a g + b h, R_md = Exp(rotation_vector g) R_0.

    g(t) and h(t) are the factors of `shape`, the number of a `Shape`. x_0 and R_0 are the start
    pose, given by `position` [m] and `orientation` (quaternion). a is `translation` (3) [m], b is
    `second_translation` (3) [m], and `rotation_vector` (3) is in rad, all in I. `frequency` is in
    Hz. The rotation axis is fixed. Therefore the angular velocity is exactly rotation_vector g'.
    """
    ramp = Scalar(*quintic_ramp(t, ramp_time))
    omega = 2.0 * ca.pi * frequency
    s, c = ca.sin(omega * t), ca.cos(omega * t)
    r, rd, rdd = ramp
    sine = Scalar(r * s, rd * s + r * omega * c, rdd * s + 2.0 * rd * omega * c - r * omega**2 * s)
    versine = ramp.times(Scalar(1.0 - c, omega * s, omega**2 * c))
    none = Scalar(SX(0), SX(0), SX(0))
    periodic = ca.logic_or(shape == int(Shape.sine), shape == int(Shape.circle))
    g = selected(periodic, sine.times(fade), selected(shape == int(Shape.line), ramp, none))
    h = selected(shape == int(Shape.circle), versine.times(fade), none)
    still = SX(3, 1)
    first, second = ca.vertcat(translation, rotation_vector), ca.vertcat(second_translation, still)
    return Motion(
        position + translation * g.value + second_translation * h.value,
        rotation.product(
            rotation.about(rotation_vector * g.value), rotation.normalised(orientation)
        ),
        first * g.first + second * h.first,
        first * g.second + second * h.second,
    )


def selected(condition: SX, if_true: Scalar, if_false: Scalar) -> Scalar:
    return Scalar(*(ca.if_else(condition, a, b) for a, b in zip(if_true, if_false, strict=True)))


def drifting(motion: Motion, t: SX, drift: SX) -> Motion:
    """Return the motion with a constant velocity added: x_md + v t, Exp(w t) R_md.

    `drift` is [v; w] (6) [m/s, rad/s], in I. The target of an approach drifts and rotates in this
    way. The rotation drifts about the end-effector, so that the position does not depend on w.
    """
    v, w = drift[:3], drift[3:]
    turned = rotation.about(w * t)
    R = rotation.matrix(turned)
    own, own_rate = R @ motion.velocity[3:], R @ motion.acceleration[3:]
    return Motion(
        motion.position + v * t,
        rotation.product(turned, motion.orientation),
        ca.vertcat(motion.velocity[:3] + v, own + w),
        ca.vertcat(motion.acceleration[:3], own_rate + ca.cross(w, own)),
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
