"""Disturbances of a control loop: pulses, sines, saturation, and thrusters that are on or off."""

from __future__ import annotations

import casadi as ca

SX = ca.SX
GRID = 1e-9
"""Tolerance [s] with which a time counts as reached."""


def pulse(t: SX, start: SX, length: SX, repeat: SX) -> SX:
    """Return 1 during a pulse, and 0 otherwise.

    The first pulse is from `start` to `start` + `length` [s]. Further pulses start every `repeat`
    [s]. If `repeat` is 0, there is one pulse.
    """
    since = t - start + GRID
    every = ca.if_else(repeat > 0, repeat, 1.0)
    since = ca.if_else(
        ca.logic_and(repeat > 0, since > 0), since - ca.floor(since / every) * every, since
    )
    return ca.logic_and(since >= 0, since < length)


def saturated(F: SX, limit: SX) -> SX:
    """Return each element of F, limited to -limit ... limit."""
    return ca.fmin(ca.fmax(F, -limit), limit)


def on_time(F: SX, force: SX, period: SX, shortest: SX) -> SX:
    """Return the time [s] for which a thruster of `force` is on, to give the mean F over a period.

    A time below half of `shortest` becomes 0, a time below `shortest` becomes `shortest`.
    """
    wanted = ca.fmin(ca.fabs(F) / force, 1.0) * period
    return ca.if_else(wanted < 0.5 * shortest, 0.0, ca.fmax(wanted, ca.fmin(shortest, period)))
