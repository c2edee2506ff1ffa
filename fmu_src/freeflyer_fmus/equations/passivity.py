"""Passivity observers and controllers, (18)-(26), per degree of freedom.

The observed energy E of a port is E(0) plus the energy that the controller has ABSORBED through
this port. The port is passive if E >= 0. In the paper, (20) and (23) add F v T. F is the force on
the robot, and v is the velocity of the port. Therefore F v T is energy that the controller supplies
to the robot, not energy that it absorbs. This module subtracts F v T.

A bookkeeping is a way to count energy. There are two bookkeepings:
`as_printed`  As in the paper. The passivity controller is a damper with the coefficient beta. Its
              energy is beta(k-1) v(k-1)^2 T. This value is known in advance, at sample k-1. F v T
              is computed from the values at sample k.
`applied`     The force that acted since the last sample includes the force of the damper. Only the
              work of this force is counted. No energy is computed in advance.
Both controllers must use the same bookkeeping. Port M and port B can have different ones.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Literal

import casadi as ca

from freeflyer_fmus.equations.sampled_control import sampled_damping
from freeflyer_fmus.equations.spatial import solve_positive_definite

SX = ca.SX


class Observer(IntEnum):
    """Power that the observers integrate.

    F_m* and F_b* are the feed-forward wrenches. dx_m' is the velocity error of the end-effector.
    """

    # The powers are F_m x_m' and F_B(k_b) x_b', as in the paper. k_b counts the samples of the base
    # controller. F_B is held between these samples.
    paper = 1
    # The powers are F_m x_m' and F_B(k_m) x_b'.
    # F_B(k_m) = F'_b(k_b) - J_b(k_m)^T F'_m(k_m) is the wrench that acts at port B. k_m counts the
    # samples of the manipulator controller.
    port = 2
    # The powers are (F_m - F_m*) dx_m' and (F_B - F_b*) x_b'. The work of the feed-forward is not
    # counted. The damper acts on dx_m'.
    tracking = 3
    # As `tracking`. In addition, each port must absorb what a continuous spring-damper would have
    # absorbed (`reference_energy`). Energy that a disturbance brings in is then no credit.
    reference = 4


def excludes_feed_forward(observer: SX) -> SX:
    """Return whether `observer`, the number of an `Observer`, does not count feed-forward work."""
    return ca.logic_or(observer == int(Observer.tracking), observer == int(Observer.reference))


class Bookkeeping(IntEnum):
    """Bookkeeping of both ports, or of port M (manipulator) and port B (base)."""

    as_printed = 1
    applied = 2
    manipulator_applied_base_as_printed = 3
    manipulator_as_printed_base_applied = 4


class DamperInertia(IntEnum):
    """Inertia M~ of each axis in the upper bound of a damper (`bounded`).

    `diagonal`: the diagonal of M~. The axes are coupled. Therefore a single axis can move less
    inertia than that, and a damper at its bound can generate energy.
    `coupled`: `coupled_inertia`. A damper at its bound dissipates energy, whatever the coupling.
    """

    diagonal = 1
    coupled = 2


def is_applied(bookkeeping: SX, port: Literal["manipulator", "base"]) -> SX:
    """Return whether `bookkeeping`, the number of a `Bookkeeping`, is `applied` at this port."""
    (mixed,) = (option for option in Bookkeeping if f"{port}_applied" in option.name)
    return ca.logic_or(bookkeeping == int(Bookkeeping.applied), bookkeeping == int(mixed))


def choose(selector: SX, options: dict[IntEnum, SX]) -> SX:
    """Return the option whose number equals the selector's value."""
    (_, result), *others = options.items()
    for option, value in others:
        result = ca.if_else(selector == int(option), value, result)
    return result


def observed_as_printed(E: SX, F: SX, v: SX, beta_before: SX, v_before: SX, T: SX) -> SX:
    """Return E(k) = E(k-1) - F(k) v(k) T + beta(k-1) v(k-1)^2 T.

    This is (20) for one port and (23) for the other port, with the corrected sign of F v T.
    """
    return E - F * v * T + beta_before * v_before**2 * T


def observed_as_applied(E: SX, F_acted: SX, v_before: SX, v: SX, T: SX) -> SX:
    """Return E(k) = E(k-1) - F(k-1) (x(k) - x(k-1)) (Stramigioli et al., T-RO 2005).

    `F_acted` is F(k-1), the force that acted since the last sample. The equation is exact if this
    force was held, that is, constant between the two samples. The displacement x(k) - x(k-1) is
    computed from the two measured velocities by the trapezoidal rule. This rule is valid for
    translation and for rotation.
    """
    return E - F_acted * (0.5 * T) * (v_before + v)


def reference_energy(stored: SX, stored_before: SX, damping: SX | float, v: SX, T: SX) -> SX:
    """Return the energy that a continuous spring-damper absorbs in one period T.

    This is the change of the potential, `stored` - `stored_before`, and the dissipation D v^2 T.
    The idea is after Ryu, Preusche, Hannaford and Hirzinger (time domain passivity control with
    reference energy following).
    """
    return stored - stored_before + damping * v**2 * T


def common_damper(E: SX, v: SX, weight: SX, T: SX, floor: SX) -> SX:
    """Return one beta for all degrees of freedom of a port: 0 if the sum of E is not negative.

    At the velocity v (6), dampers with this beta dissipate the missing energy in one period T.
    `weight` [m/rad] multiplies angular velocities. It makes the sum of squares one unit.
    """
    speed = ca.sumsqr(v[:3]) + weight**2 * ca.sumsqr(v[3:])
    missing = -ca.sum1(E)
    return ca.if_else(missing > 0, missing / ca.fmax(speed * T, floor), 0.0)


def damper(E: SX, v: SX, T: SX, floor: SX) -> SX:
    """Return beta of (24), the coefficient of the damper. The result is 0 if E >= 0.

    If E < 0, the energy deficit is -E. At the velocity v, the damper dissipates this deficit in one
    period T. Near rest, v^2 T is almost zero, and `floor` is used instead of v^2 T. Therefore beta
    stays finite, and the deficit is dissipated later, at a larger velocity.
    """
    return ca.if_else(E < 0, -E / ca.fmax(v**2 * T, floor), 0.0)


def bounded(beta: SX, fraction: SX, inertia: SX, damping: SX, T: SX) -> SX:
    """Return beta, limited to at most max(0, c M~ / T - K_D).

    c is `fraction`, M~ is `inertia`, and K_D is `damping`, the damping of the control law. A
    sampled damper generates energy if its coefficient is above 2 M~ / T. With the limit, the damper
    may dissipate only a part of the energy deficit. The rest of the deficit is dissipated later.
    """
    return ca.fmin(beta, ca.fmax(0.0, fraction * inertia / T - damping))


def bound_of_axes(
    choice: SX, is_matched: SX, inertia: SX, K_P: SX, K_D: SX, T: SX, theta: SX
) -> tuple[SX, SX]:
    """Return M~ (6) and the damping of the control law (6), for `bounded`.

    `choice` is the number of a `DamperInertia`. `inertia` is M (6, 6). The law is the matched or
    the emulated law with the diagonals K_P (6) and K_D (6) and the period T.

    The damping of the matched law is a full matrix, (A^-1 + theta T M^-1)^-1 with A = K_D + theta T
    K_P. `diagonal` uses an upper bound of its diagonal. `coupled` uses A, which is larger in the
    sense of definite matrices.
    """
    is_coupled = choice == int(DamperInertia.coupled)
    of_matched_law = ca.if_else(
        is_coupled, K_D + theta * T * K_P, sampled_damping(ca.diag(inertia), K_P, K_D, T, theta)
    )
    return (
        ca.if_else(is_coupled, coupled_inertia(inertia), ca.diag(inertia)),
        ca.if_else(is_matched, of_matched_law, K_D),
    )


def coupled_inertia(inertia: SX) -> SX:
    """Return m (6), for which M - diag(m) is positive semidefinite. `inertia` is M (6, 6).

    M is symmetric and positive definite. With N = M^-1, m_i = 1 / sum_j |N_ij| sqrt(N_ii / N_jj).
    1 / N_ii is the inertia that axis i alone moves. m_i is smaller, because dampers act on the
    other axes at the same time. The axes can have different units.

    Proof: let W = diag(N_ii)^(1/2). The absolute row sums of W diag(m) N W^-1 are 1. Therefore the
    eigenvalues of diag(m) N are at most 1.

    A wrench -S v that is held for T changes the kinetic energy by -T/2 v^T (2 S - T S N S) v. For
    S > 0, this is negative for every v if S < 2 M / T. If diag(beta) plus the damping of the law is
    at most c diag(m) / T, it is at most c M / T. Therefore the sum of both dissipates energy for
    every c below 2. With c <= 1, it reverses no motion.
    """
    N = solve_positive_definite(inertia, SX.eye(6))
    w = ca.sqrt(ca.diag(N))
    return 1.0 / (w * (ca.fabs(N) @ (1.0 / w)))
