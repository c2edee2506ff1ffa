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

from dataclasses import dataclass

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


@dataclass(frozen=True, kw_only=True)
class CoupledDamper:
    """Sampled damper of six coupled axes, in the direction with the largest ratio.

    `ratio` is K_D T / (2 M~). K_D and M~ are the damping and the inertia in this direction.
    `direction` (6) is the velocity [linear; angular] in I. The part that dissipates more is scaled
    to a unit vector.
    """

    ratio: float
    direction: Array

    def motion(self, body: str) -> str:
        """Describe the direction of the motion of `body`."""
        linear, angular = self.direction[:3], self.direction[3:]
        rotates = abs(np.linalg.norm(angular) - 1.0) < 1e-9
        axis = ", ".join(f"{x:.2f}" for x in np.round(angular if rotates else linear, 2) + 0.0)
        return f"{body} {'rotation about' if rotates else 'translation along'} ({axis})"


def coupled_damper(
    rates: Array, damping: Array, period: float, *, late: bool = False
) -> CoupledDamper:
    """Return the sampled damper of six coupled axes with the period T [s].

    `rates` (6, 6) is M^-1 K_D [1/s]: a velocity v causes the acceleration -`rates` v. The velocity
    at the end of a period is (1 - T M^-1 K_D) v. In the direction of an eigenvector, with the
    eigenvalue K_D / M~, the multiplier is 1 - K_D T / M~. It is below -1 if K_D T / (2 M~) is above
    1. `damping` (6) is the diagonal of K_D. `late` is that of `sampled_damper`.
    """
    values, vectors = np.linalg.eig(rates)
    k = int(np.argmax(values.real))
    direction = vectors[:, k].real
    dissipates = damping * direction**2
    part = direction[3:] if dissipates[3:].sum() >= dissipates[:3].sum() else direction[:3]
    size = np.linalg.norm(part) * np.sign(part[np.argmax(np.abs(part))])
    ratio = sampled_damper(values[k].real, np.ones(()), period, late=late)
    return CoupledDamper(ratio=float(ratio), direction=direction / (size or 1.0))
