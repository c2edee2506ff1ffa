"""Modes of the loop over one base period T_b: frequency, growth rate, and cause of an instability.

The prediction varies the period of one controller, usually the base controller. This period is
called T_b.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Literal

import numpy as np

from freeflyer.analysis.prediction.held_axis import (
    CoupledDamper,
    sampled_damper,
    sampled_spring,
)
from freeflyer.analysis.prediction.lifting import PeriodMap
from freeflyer.analysis.prediction.task_coordinates import DEGREES, TaskCoordinates
from freeflyer.fmi.component import Array

MOSTLY = 0.9
"""A mode is called a mode of one body if this body has at least this share of the mode's energy."""
REPORTED_SHARE = 0.05
"""A description lists the degrees of freedom that have at least this share of the mode's energy."""
AT_LIMIT = 0.9
"""An axis is the cause of the instability if one of its two ratios is at least this value.

`held_axis` defines the two ratios. They are computed at the stability boundary. For a single axis,
the limit of both ratios is 1. The coupling of several axes increases or decreases this limit by a
few percent.
"""
REAL = 1e-6
"""A multiplier counts as real if its angle to the real axis is below this value [rad]."""


Kind = Literal["sampled spring", "sampled damper", "hand", "coupling"]
"""Cause that limits T_b.

With "sampled spring" and "sampled damper", an axis of the base does not meet the condition with
this name in `held_axis`. With "hand", the cause is in the loop of the end-effector: it is unstable
at every T_b, or the unstable mode hardly moves the base. The name "hand" is a value in
prediction.json. With "coupling", the cause is the coupling of base and end-effector.
"""


@dataclass(frozen=True, kw_only=True)
class Mode:
    """One eigenvalue (multiplier) of the map over one base period.

    `period` is the base period [s]. `shares` (12) contains, for each degree of freedom, its share
    of the energy of the eigenvector. The sum of the shares is 1. `growth_rate` is ln |z| / T_b
    [1/s] of multiplier z. It is negative for a decaying mode. If |z| is above the range of a
    double, `multiplier` has the largest absolute value of the range, and `growth_rate` is exact.
    """

    period: float
    multiplier: complex
    shares: Array
    growth_rate: float

    @property
    def frequency(self) -> float:
        """Frequency [Hz]. It is at most half of the sampling frequency."""
        return abs(math.atan2(self.multiplier.imag, self.multiplier.real)) / (
            2.0 * math.pi * self.period
        )

    @property
    def body(self) -> Literal["base", "hand", "coupling"]:
        """Body with most of the energy. "hand" is the end-effector."""
        base = float(self.shares[:6].sum())
        return "base" if base >= MOSTLY else "hand" if base <= 1.0 - MOSTLY else "coupling"

    @property
    def alternates(self) -> bool:
        """Whether the multiplier is real and negative. Such a mode changes sign at each sample."""
        return (
            self.multiplier.real < 0.0
            and abs(math.atan2(self.multiplier.imag, -self.multiplier.real)) < REAL
        )

    @property
    def oscillates(self) -> bool:
        """Whether the multiplier is complex."""
        return (
            not self.alternates
            and abs(math.atan2(self.multiplier.imag, self.multiplier.real)) >= REAL
        )

    def description(self) -> str:
        """Describe the mode: degrees of freedom sorted by energy, body, and behaviour over time."""
        order = [int(k) for k in np.argsort(-self.shares) if self.shares[k] >= REPORTED_SHARE]
        parts = ", ".join(f"{DEGREES[k]} ({100 * self.shares[k]:.0f} %)" for k in order)
        kind = {
            "base": "a base mode",
            "hand": "an end-effector mode",
            "coupling": "a coupled mode of base and end-effector",
        }[self.body]
        if self.alternates:
            behaviour = f"changes sign at every sample of the base ({self.frequency:.3g} Hz)"
        elif self.oscillates:
            behaviour = f"oscillates at {self.frequency:.3g} Hz, {1.0 / (self.frequency * self.period):.3g} samples of the base per cycle"
        else:
            behaviour = (
                "grows without oscillating"
                if abs(self.multiplier) >= 1.0
                else "decays without oscillating"
            )
        return f"{parts}: {kind}, which {behaviour}"


@dataclass(frozen=True, kw_only=True)
class Limit:
    """Cause that limits T_b. `axis` is the axis of the base with the largest share of the energy.

    `spring` (6) is the ratio K_P T_b / (2 K_D) of each axis of the base. `damper` (6) is the ratio
    K_D T_b / (2 M~) of each axis. M~ is the inertia of the base in this axis. The ratios are
    computed at the stability boundary. A single axis is stable if both ratios are below 1. `late`
    is true in parallel exchange. The ratios are then 3 K_P T_b / (2 K_D) and K_D T_b / M~.
    `fast_damper` is the same ratio K_D T_m / (2 M~) of the end-effector's own loop.
    """

    kind: Kind
    axis: str
    spring: Array
    damper: Array
    late: bool
    fast_damper: CoupledDamper

    def description(self) -> str:
        """Describe the cause, with the two ratios of the axis and the remedy."""
        k = DEGREES.index(self.axis)
        if self.kind == "hand":
            return self._of_end_effector()
        names = (
            ("3 K_P T_b / 2 K_D", "K_D T_b / M~")
            if self.late
            else ("K_P T_b / 2 K_D", "K_D T_b / 2 M~")
        )
        figures = f"{names[0]} = {self.spring[k]:.3g} and {names[1]} = {self.damper[k]:.3g} in {self.axis}"
        figures += "; in parallel exchange the wrench acts T_b later" if self.late else ""
        if self.kind == "sampled spring":
            return f"the sampled spring ({figures}; the limit is 1): more damping helps"
        if self.kind == "sampled damper":
            return f"the sampled damper ({figures}; the limit is 1): more damping makes the loop less stable"
        return f"the coupling of base and manipulator ({figures}: neither value is near the limit of 1)"

    def _of_end_effector(self) -> str:
        name = "K_D T_m / M~" if self.late else "K_D T_m / 2 M~"
        figure = f"{name} = {self.fast_damper.ratio + 0.0:.3g}"
        if self.fast_damper.ratio < 1.0:
            return f"the end-effector loop: the base hardly moves in this mode ({figure}; the limit is 1)"
        return (
            f"the end-effector loop itself, a sampled damper that is unstable at every T_b ({figure} in {self.fast_damper.motion('end-effector')}; the limit is 1): "
            f"less damping of the end-effector, a shorter T_m, or the matched law of its controller (discretisation = matched) helps"
        )


LARGEST = math.log(sys.float_info.max)
"""ln of the largest number. A larger multiplier is replaced by this number."""


def modes(
    period_map: PeriodMap, period: float, coordinates: TaskCoordinates, states: int
) -> list[Mode]:
    """Return all modes of a map over one base period. The least stable mode comes first.

    `period` is the base period [s]. A pair of complex multipliers is one mode. The first `states`
    elements of the vectors of the map are the plant's states. `coordinates` gives their energy.
    """
    values, vectors = np.linalg.eig(period_map.matrix)
    found = []
    for k in np.argsort(-np.abs(values), kind="stable"):
        if values[k].imag >= 0.0:
            energy = coordinates.energy(vectors[:states, k])
            size = max(abs(values[k]), sys.float_info.min)
            growth = math.log(size) + period_map.scale
            # The energy of a mode in the null space is zero. `or 1.0` avoids a division by zero.
            found.append(
                Mode(
                    period=period,
                    multiplier=complex(values[k])
                    if period_map.scale == 0.0
                    else complex(values[k]) / size * math.exp(min(growth, LARGEST)),
                    shares=energy / (energy.sum() or 1.0),
                    growth_rate=growth / period,
                )
            )
    return found


def limit_of(mode: Mode, coordinates: TaskCoordinates, *, late: bool = False) -> Limit:
    """Return the cause that limits T_b.

    `mode` is the mode that becomes unstable at the stability boundary. `late` is true in parallel
    exchange.
    """
    axis = int(np.argmax(mode.shares[:6]))
    spring = sampled_spring(
        coordinates.stiffness[:6], coordinates.damping[:6], mode.period, late=late
    )
    damper = sampled_damper(
        coordinates.damping[:6], coordinates.inertia[:6], mode.period, late=late
    )
    of_end_effector = mode.body == "hand" or coordinates.fast_damper.ratio >= 1.0
    kind: Kind = "hand" if of_end_effector else "coupling"
    if not of_end_effector and mode.oscillates and spring[axis] >= AT_LIMIT:
        kind = "sampled spring"
    elif not of_end_effector and (mode.alternates or late) and damper[axis] >= AT_LIMIT:
        kind = "sampled damper"
    return Limit(
        kind=kind,
        axis=DEGREES[axis],
        spring=spring,
        damper=damper,
        late=late,
        fast_damper=coordinates.fast_damper,
    )
