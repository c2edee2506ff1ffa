"""One axis under a held spring and damper: m x'' = -K_P x(k) - K_D x'(k), with k the last of samples T apart.

The map over T has trace 2 - K_P T^2 / 2m - K_D T / m and determinant 1 - K_D T / m + K_P T^2 / 2m. Jury's conditions for both
multipliers inside the unit circle are then K_P T / 2 < K_D (determinant below 1: the sampled spring), K_D T < 2 m (no multiplier
below -1: the sampled damper) and K_P > 0. docs/prediction.md derives them.
"""

from __future__ import annotations

import numpy as np

from freeflyer.fmi.component import Array


def sampled_spring(stiffness: Array, damping: Array, period: float, *, late: bool = False) -> Array:
    """K_P T / (2 K_D), elements by elements: stable below 1. Infinite for a spring without damping. SI, T in s.

    `late`: the answer is handed over at the next sample (parallel exchange). The spring then acts 3/2 T late on the average and
    not T / 2, so that 3 K_P T / (2 K_D) is given; to first order in T.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = stiffness * (3.0 if late else 1.0) * period / (2.0 * damping)
    return np.where(damping > 0.0, ratio, np.inf)


def sampled_damper(damping: Array, inertia: Array, period: float, *, late: bool = False) -> Array:
    """K_D T / (2 m), elements by elements: stable below 1. SI, T in s. `late`: K_D T / m, for z^2 - z + K_D T / m = 0."""
    return np.asarray(damping * period / ((1.0 if late else 2.0) * inertia))
