"""Passivity observers and controllers, (18)-(26), per degree of freedom.

The observed energy E of a port is the energy that the controller has ABSORBED through this port,
plus E(0). The port is passive if E >= 0. The printed (20) and (23) add F v T, where F is the force
on the robot. F v T is energy supplied to the robot. Therefore the sign of this term is reversed
here.

A bookkeeping is a way to count energy. There are two bookkeepings:
`as_printed`  The energy of the damper is beta(k-1) v(k-1)^2 T, which is known in advance at sample
              k-1. F v T is computed from the values at sample k.
`applied`     Only the work of the force applied since the last sample is counted. This force
              includes the force of the damper. No energy is computed in advance.
Both controllers must use the same bookkeeping.
"""

from __future__ import annotations

from enum import IntEnum

import casadi as ca

SX = ca.SX


class Observer(IntEnum):
    """Power that the observers integrate.

    F_m* and F_b* are the feed-forward wrenches. dx_m' is the velocity error of the end-effector.
    """

    # The powers are F_m x_m' and F_B(k_b) x_b', as in the paper. F_B is held between the samples
    # of the base controller.
    paper = 1
    # The powers are F_m x_m' and F_B(k_m) x_b'.
    # F_B(k_m) = F'_b(k_b) - J_b(k_m)^T F'_m(k_m) is the applied wrench.
    port = 2
    # The powers are (F_m - F_m*) dx_m' and (F_B - F_b*) x_b'. The work of the feed-forward is not
    # counted. The damper acts on dx_m'.
    tracking = 3


class Bookkeeping(IntEnum):
    as_printed = 1
    applied = 2


def choose(selector: SX, options: dict[IntEnum, SX]) -> SX:
    """Return the option whose number equals the selector's value."""
    (_, result), *others = options.items()
    for option, value in others:
        result = ca.if_else(selector == int(option), value, result)
    return result


def observed_as_printed(E: SX, F: SX, v: SX, beta_before: SX, v_before: SX, T: SX) -> SX:
    """Return E(k) = E(k-1) - F(k) v(k) T + beta(k-1) v(k-1)^2 T.

    These are (20) and (23) with corrected sign.
    """
    return E - F * v * T + beta_before * v_before**2 * T


def observed_as_applied(E: SX, F_acted: SX, v_before: SX, v: SX, T: SX) -> SX:
    """Return E(k) = E(k-1) - F(k-1) (x(k) - x(k-1)) (Stramigioli et al., T-RO 2005).

    The equation is exact for a held force. A held force is constant between two samples. The
    displacement is integrated from the measured velocities by the trapezoidal rule. This rule is
    valid for translation and for rotation.
    """
    return E - F_acted * (0.5 * T) * (v_before + v)


def damper(E: SX, v: SX, T: SX, floor: SX) -> SX:
    """Return beta of (24). The result is 0 if E >= 0.

    At the velocity v, beta dissipates the energy deficit -E in one period T. v^2 T is limited to at
    least `floor`. Therefore beta stays finite near rest, and the deficit is dissipated later.
    """
    return ca.if_else(E < 0, -E / ca.fmax(v**2 * T, floor), 0.0)


def bounded(beta: SX, fraction: SX, inertia: SX, damping: SX, T: SX) -> SX:
    """Return beta, limited to at most max(0, c M~ / T - K_D).

    A sampled damper generates energy if its coefficient is above 2 M~ / T. The limited damper
    dissipates only a part of the energy deficit. The rest of the deficit is dissipated later.
    """
    return ca.fmin(beta, ca.fmax(0.0, fraction * inertia / T - damping))
