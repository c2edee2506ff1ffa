"""Passivity observers and controllers, (18)-(26), degree of freedom by degree of freedom.

Energies are what the controller has ABSORBED through its port, E(0) included: the port is passive while E >= 0. The printed
(20) and (23) add F v T with F the force on the robot, which is energy given; that sign is turned here.

Two bookkeepings, never to be mixed:
`as_printed`  the damper's energy is credited ahead, beta(k-1) v(k-1)^2 T, and F v T is taken at the sample;
`applied`     only what acted since the last sample is booked, the damper included: nothing is credited ahead.
"""

from __future__ import annotations

from enum import IntEnum

import casadi as ca

SX = ca.SX


class Observer(IntEnum):
    """Which power the observers watch; F_m* and F_b* are the feed-forward, dx_m' the velocity error."""

    paper = 1  # F_m x_m' and F_B(k_b) x_b' with F_B held between base samples, as printed
    port = 2  # F_m x_m' and F_B(k_m) x_b' with F_B(k_m) = F'_b(k_b) - J_b(k_m)^T F'_m(k_m), the wrench that really acts
    tracking = 3  # (F_m - F_m*) dx_m' and (F_B - F_b*) x_b': feed-forward work is no activity; the arm's damper acts on dx_m'


class Bookkeeping(IntEnum):
    as_printed = 1
    applied = 2


def choose(selector: SX, options: dict[IntEnum, SX]) -> SX:
    """The option whose number the selector has."""
    (_, result), *others = options.items()
    for option, value in others:
        result = ca.if_else(selector == int(option), value, result)
    return result


def observed_as_printed(E: SX, F: SX, v: SX, beta_before: SX, v_before: SX, T: SX) -> SX:
    """Eq. (20), (23), sign corrected: E(k) = E(k-1) - F(k) v(k) T + beta(k-1) v(k-1)^2 T."""
    return E - F * v * T + beta_before * v_before**2 * T


def observed_as_applied(E: SX, F_acted: SX, v_before: SX, v: SX, T: SX) -> SX:
    """E(k) = E(k-1) - F(k-1) (x(k) - x(k-1)): exact for a held force (Stramigioli et al., T-RO 2005).

    The displacement is the trapezoid of the measured velocities, which serves translation and rotation alike.
    """
    return E - F_acted * (0.5 * T) * (v_before + v)


def damper(E: SX, v: SX, T: SX, floor: SX) -> SX:
    """beta of (24): what dissipates the deficit -E in one T at the velocity v; 0 while E >= 0.

    v^2 T is floored, so that near rest beta stays finite and the deficit waits.
    """
    return ca.if_else(E < 0, -E / ca.fmax(v**2 * T, floor), 0.0)


def bounded(beta: SX, fraction: SX, inertia: SX, damping: SX, T: SX) -> SX:
    """beta <= max(0, c M~ / T - K_D): a sampled damper beyond 2 M~ / T makes energy itself; the rest of the deficit waits."""
    return ca.fmin(beta, ca.fmax(0.0, fraction * inertia / T - damping))
