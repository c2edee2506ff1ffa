"""A mode of the lifted loop in words: which degrees of freedom move, how fast, how it grows, and what makes it grow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from freeflyer.analysis.prediction.held_axis import sampled_damper, sampled_spring
from freeflyer.analysis.prediction.task_coordinates import DEGREES, TaskCoordinates
from freeflyer.fmi.component import Array

MOSTLY = 0.9
"""Share of the energy from which a mode belongs to one body."""
WORTH_SAYING = 0.05
"""Share of the energy from which a degree of freedom is named."""
AT_LIMIT = 0.9
"""From this much of its limit on, at the boundary, an axis's sampled spring or damper counts as what limits T_b: coupling moves
boundaries by some percent. Beyond 1 the axis alone would be unstable already, and the coupling helps.
"""
REAL = 1e-6
"""Angle [rad] below which a multiplier counts as real."""


Kind = Literal["sampled spring", "sampled damper", "hand", "coupling"]
"""What limits T_b: one of the two conditions of freeflyer.analysis.prediction.held_axis in an axis of the base, the hand's own loop, or neither."""


@dataclass(frozen=True, kw_only=True)
class Mode:
    """One multiplier of the map over a base period [s], and its eigenvector's energy per degree of freedom, in shares (12)."""

    period: float
    multiplier: complex
    shares: Array

    @property
    def growth_rate(self) -> float:
        """ln |z| / T_b [1/s]; negative: it decays."""
        return math.log(abs(self.multiplier)) / self.period

    @property
    def frequency(self) -> float:
        """[Hz]; at most half of the sampling frequency."""
        return abs(math.atan2(self.multiplier.imag, self.multiplier.real)) / (
            2.0 * math.pi * self.period
        )

    @property
    def body(self) -> Literal["base", "hand", "coupling"]:
        base = float(self.shares[:6].sum())
        return "base" if base >= MOSTLY else "hand" if base <= 1.0 - MOSTLY else "coupling"

    @property
    def alternates(self) -> bool:
        return (
            self.multiplier.real < 0.0
            and abs(math.atan2(self.multiplier.imag, -self.multiplier.real)) < REAL
        )

    @property
    def oscillates(self) -> bool:
        return (
            not self.alternates
            and abs(math.atan2(self.multiplier.imag, self.multiplier.real)) >= REAL
        )

    def words(self) -> str:
        order = [int(k) for k in np.argsort(-self.shares) if self.shares[k] >= WORTH_SAYING]
        parts = ", ".join(f"{DEGREES[k]} ({100 * self.shares[k]:.0f} %)" for k in order)
        kind = {
            "base": "a base mode",
            "hand": "a hand mode",
            "coupling": "a coupling of base and hand",
        }[self.body]
        if self.alternates:
            how = f"changes sign from one sample of the base to the next ({self.frequency:.3g} Hz)"
        elif self.oscillates:
            how = f"oscillates at {self.frequency:.3g} Hz, {1.0 / (self.frequency * self.period):.3g} samples of the base a cycle"
        else:
            how = (
                "grows without oscillating"
                if abs(self.multiplier) >= 1.0
                else "decays without oscillating"
            )
        return f"{parts}: {kind}, which {how}"


@dataclass(frozen=True, kw_only=True)
class Limit:
    """What limits T_b, judged from one axis alone: the base's axis with the largest share in the mode that becomes unstable.

    `spring` = K_P T_b / 2 K_D and `damper` = K_D T_b / 2 M~ of the base's six axes at the boundary: an axis by itself is stable
    with both below 1. `late`: what parallel exchange makes of them, 3 K_P T_b / 2 K_D and K_D T_b / M~.
    """

    kind: Kind
    axis: str
    spring: Array
    damper: Array
    late: bool

    def words(self) -> str:
        k = DEGREES.index(self.axis)
        names = (
            ("3 K_P T_b / 2 K_D", "K_D T_b / M~")
            if self.late
            else ("K_P T_b / 2 K_D", "K_D T_b / 2 M~")
        )
        figures = f"{names[0]} = {self.spring[k]:.3g} and {names[1]} = {self.damper[k]:.3g} in {self.axis}"
        figures += ", a whole T_b late by parallel exchange" if self.late else ""
        if self.kind == "sampled spring":
            return f"the sampled spring ({figures}; the limit is 1): more damping helps"
        if self.kind == "sampled damper":
            return f"the sampled damper ({figures}; the limit is 1): more damping makes it worse"
        if self.kind == "hand":
            return "the hand's own loop: the base hardly moves in this mode"
        return f"the coupling with the arm ({figures}: neither is near its limit of 1)"


def modes(
    period_map: Array, period: float, coordinates: TaskCoordinates, states: int
) -> list[Mode]:
    """All modes of a map over a base period [s], the least stable first; of a complex pair the one with positive frequency."""
    values, vectors = np.linalg.eig(period_map)
    found = []
    for k in np.argsort(-np.abs(values), kind="stable"):
        if values[k].imag >= 0.0:
            energy = coordinates.energy(vectors[:states, k])  # none in a null space
            found.append(
                Mode(
                    period=period,
                    multiplier=complex(values[k]),
                    shares=energy / (energy.sum() or 1.0),
                )
            )
    return found


def limit_of(mode: Mode, coordinates: TaskCoordinates, *, late: bool = False) -> Limit:
    """What limits T_b at the boundary, where this mode's multiplier leaves the unit circle. `late`: in parallel exchange."""
    axis = int(np.argmax(mode.shares[:6]))
    spring = sampled_spring(
        coordinates.stiffness[:6], coordinates.damping[:6], mode.period, late=late
    )
    damper = sampled_damper(
        coordinates.damping[:6], coordinates.inertia[:6], mode.period, late=late
    )
    kind: Kind = "hand" if mode.body == "hand" else "coupling"
    if mode.body != "hand" and mode.oscillates and spring[axis] >= AT_LIMIT:
        kind = "sampled spring"
    elif mode.body != "hand" and (mode.alternates or late) and damper[axis] >= AT_LIMIT:
        kind = "sampled damper"
    return Limit(kind=kind, axis=DEGREES[axis], spring=spring, damper=damper, late=late)
