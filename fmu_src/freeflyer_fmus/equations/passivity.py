"""Passivity observers and controllers, (18)-(26), per degree of freedom.

Observed energies are the energies ABSORBED by the controller through its port, E(0) included: the
port is passive if E >= 0. The printed (20) and (23) add F v T with F the force on the robot, which
is supplied energy; that sign is corrected here.

There are two bookkeepings, which must not be mixed:
`as_printed`  the damper's energy beta(k-1) v(k-1)^2 T is credited in advance, and F v T is taken at
              the sample;
`applied`     only the force applied since the last sample is booked, the damper included; nothing
              is credited in advance.
"""

from __future__ import annotations

from enum import IntEnum

import casadi as ca

SX = ca.SX


class Observer(IntEnum):
    """Power that the observers integrate; F_m*, F_b*: feed-forward, dx_m': velocity error."""

    # F_m x_m' and F_B(k_b) x_b' with F_B held between base samples, as printed
    paper = 1
    # F_m x_m' and F_B(k_m) x_b' with the applied wrench F_B(k_m) = F'_b(k_b) - J_b(k_m)^T F'_m(k_m)
    port = 2
    # (F_m - F_m*) dx_m' and (F_B - F_b*) x_b': without feed-forward work; the damper acts on dx_m'
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
    """Return E(k) = E(k-1) - F(k) v(k) T + beta(k-1) v(k-1)^2 T: (20), (23), sign corrected."""
    return E - F * v * T + beta_before * v_before**2 * T


def observed_as_applied(E: SX, F_acted: SX, v_before: SX, v: SX, T: SX) -> SX:
    """Return E(k) = E(k-1) - F(k-1) (x(k) - x(k-1)), exact for a held force.

    Stramigioli et al., T-RO 2005. The displacement is integrated from the measured velocities by
    the trapezoidal rule, which applies to translation and rotation alike.
    """
    return E - F_acted * (0.5 * T) * (v_before + v)


def damper(E: SX, v: SX, T: SX, floor: SX) -> SX:
    """Return beta of (24), which dissipates the deficit -E in one T at velocity v; 0 if E >= 0.

    v^2 T is at least `floor`. Near rest beta stays finite, and the deficit is dissipated later.
    """
    return ca.if_else(E < 0, -E / ca.fmax(v**2 * T, floor), 0.0)


def bounded(beta: SX, fraction: SX, inertia: SX, damping: SX, T: SX) -> SX:
    """Return beta, at most max(0, c M~ / T - K_D).

    A sampled damper above 2 M~ / T generates energy. The rest of the deficit is dissipated later.
    """
    return ca.fmin(beta, ca.fmax(0.0, fraction * inertia / T - damping))
