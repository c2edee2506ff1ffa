"""Stability of one axis with a held spring-damper: m x'' = -K_P x(k) - K_D x'(k), sampled every T.

The map over T has trace 2 - K_P T^2 / 2m - K_D T / m and determinant 1 - K_D T / m + K_P T^2 / 2m.
Jury's conditions for multipliers inside the unit circle are K_P > 0 and
    K_P T / 2 < K_D  (determinant below 1: sampled spring),
    K_D T < 2 m      (no multiplier below -1: sampled damper).
docs/prediction.md derives them.
"""

from __future__ import annotations

import numpy as np

from freeflyer.fmi.component import Array


def sampled_spring(stiffness: Array, damping: Array, period: float, *, late: bool = False) -> Array:
    """Return K_P T / (2 K_D) elementwise, stable below 1; infinite without damping. SI units.

    `late`: the output acts one sample later (parallel exchange). The mean delay of the spring is
    then 3/2 T instead of T / 2, and the result is 3 K_P T / (2 K_D), to first order in T.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = stiffness * (3.0 if late else 1.0) * period / (2.0 * damping)
    return np.where(damping > 0.0, ratio, np.inf)


def sampled_damper(damping: Array, inertia: Array, period: float, *, late: bool = False) -> Array:
    """Return K_D T / (2 m) elementwise, stable below 1. SI units.

    `late` (parallel exchange): K_D T / m, from z^2 - z + K_D T / m = 0.
    """
    return np.asarray(damping * period / ((1.0 if late else 2.0) * inertia))
