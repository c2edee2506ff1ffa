"""Stability of one axis with a held spring-damper: m x'' = -K_P x(k) - K_D x'(k), sampled every T.

The wrench is held: it is constant between two samples. A linear map gives the state (x, x') at the
end of a period T from the state at its start. The trace of the map is 2 - K_P T^2 / 2m - K_D T / m.
The determinant of the map is 1 - K_D T / m + K_P T^2 / 2m. The multipliers are the eigenvalues of
the map. The axis is stable if all multipliers are inside the unit circle. Jury's criterion gives
the following conditions:
    K_P > 0,
    K_P T / 2 < K_D  (condition of the sampled spring: the determinant is below 1),
    K_D T < 2 m      (condition of the sampled damper: no multiplier is below -1).
docs/prediction.md derives these conditions.
"""

from __future__ import annotations

import numpy as np

from freeflyer.fmi.component import Array


def sampled_spring(stiffness: Array, damping: Array, period: float, *, late: bool = False) -> Array:
    """Return the ratio K_P T / (2 K_D) of each axis. All values are in SI units.

    The condition of the sampled spring is that this ratio is below 1. The ratio is infinite if the
    damping is zero. `late` is true in parallel exchange: the wrench then acts one period T later.
    The mean delay of the spring is then 3/2 T instead of T / 2. Therefore the ratio is
    3 K_P T / (2 K_D), to first order in T.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = stiffness * (3.0 if late else 1.0) * period / (2.0 * damping)
    return np.where(damping > 0.0, ratio, np.inf)


def sampled_damper(damping: Array, inertia: Array, period: float, *, late: bool = False) -> Array:
    """Return the ratio K_D T / (2 m) of each axis. All values are in SI units.

    The condition of the sampled damper is that this ratio is below 1. `late` is true in parallel
    exchange: the wrench then acts one period T later, and the ratio is K_D T / m. This ratio
    follows from the characteristic equation z^2 - z + K_D T / m = 0.
    """
    return np.asarray(damping * period / ((1.0 if late else 2.0) * inertia))
