"""Criteria for the paper's statements on Figs. 3, 4, 7, 8, 9 and 10.

The paper states them without numbers. Here each statement is a list of inequalities. Their numbers
are measured in three runs with the same assumptions: with both controllers at a high rate, without
passivity controllers (PC), and with PC.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from freeflyer.fmi.component import Array
from freeflyer.scenario.experiment import Result
from freeflyer.scenario.metrics import LAST

RUNS = ("continuous", "unstable", "passive")
ERRORS = {
    "end_effector_position": ("end-effector position", "m"),
    "end_effector_orientation": ("end-effector orientation", "deg"),
    "base_position": ("base position", "m"),
    "base_orientation": ("base orientation", "deg"),
}
PORTS = ("manipulator", "base")
JOINT_LIMIT_MARGIN = "manipulator_controller.joint_limit_margin"
SIGNALS = (
    "manipulator_controller.manipulator_observed_energy",
    "manipulator_controller.base_observed_energy",
    "manipulator_controller.passivity_wrench",
    "base_controller.passivity_wrench",
    JOINT_LIMIT_MARGIN,
)
"""Recorded signals that `measure` needs, in addition to those of the errors."""
SMALL_ROTATION = 5.0
"""Rotation of the base [deg] above which a run without PC counts as lost."""
LATE = 5.0
"""Length [s] of the last part of a diverging run. Its slope would be that of the divergence."""
GROWTH = (0.3, 0.9)
"""Part of a run in which the growth of an error is fitted, as fractions of the simulated time."""

Measures = Mapping[str, float]
Runs = Mapping[str, Measures]
"""The measures of each run in RUNS."""


def columns() -> dict[str, str]:
    """Return the unit of each number that `measure` returns, by name."""
    found = {"completed": "1", "end_s": "s", "joint_limit_margin_min": "rad"}
    for error, (_, unit) in ERRORS.items():
        found |= {f"{error}_max": unit, f"{error}_end": unit, f"{error}_growth": "1/s"}
    for port in PORTS:
        found |= {
            f"{port}_energy_least": "J",
            f"{port}_energy_slope": "J/s",
            f"{port}_energy_sum_least": "J",
            f"{port}_energy_sum_early_slope": "J/s",
            f"{port}_correction_max": "N or N m",
        }
    return found


def measure(result: Result) -> dict[str, float]:
    """Return the numbers that the criteria need of one run. The names are those of `columns`.

    `..._end` is a maximum over the last 10 s. `..._growth` is the exponential growth rate of an
    error. `..._energy_least` is the minimum over time and degrees of freedom (DoF), and
    `..._energy_slope` is the slope of a straight line through the sum over the DoF.
    `..._sum_least` is the minimum of this sum while the base has rotated by less than
    SMALL_ROTATION. `..._sum_early_slope` is the slope of the sum without the last LATE seconds.
    """
    record, time, end = result.outcome.record, result.outcome.record.time, result.outcome.simulated
    found = {
        "completed": float(not result.outcome.diverged and not result.outcome.failed),
        "end_s": end,
        "joint_limit_margin_min": float(record[JOINT_LIMIT_MARGIN].min()),
    }
    for error, (_, unit) in ERRORS.items():
        values = result.errors[f"{error}_error_{unit}"]
        found[f"{error}_max"] = float(values.max())
        found[f"{error}_end"] = float(values[time >= end - LAST].max())
        fitted = (time >= GROWTH[0] * end) & (time <= GROWTH[1] * end) & (values > 0.0)
        found[f"{error}_growth"] = slope(time[fitted], np.log(values[fitted]))
    rotation = result.errors["base_orientation_error_deg"]
    held = np.logical_and.accumulate(rotation < SMALL_ROTATION)
    early = time < end - LATE
    for port in PORTS:
        energy = record[f"manipulator_controller.{port}_observed_energy"]
        total = energy.sum(axis=1)
        found[f"{port}_energy_least"] = float(energy.min())
        found[f"{port}_energy_slope"] = slope(time, total)
        found[f"{port}_energy_sum_least"] = float(total[held].min(initial=math.inf))
        found[f"{port}_energy_sum_early_slope"] = slope(time[early], total[early])
        wrench = record[f"{port}_controller.passivity_wrench"]
        found[f"{port}_correction_max"] = float(np.abs(wrench).max())
    return found


def slope(x: Array, y: Array) -> float:
    """Return the slope of the straight line through points, or NaN if there are fewer than two."""
    return float(np.polyfit(x, y, 1)[0]) if x.size > 1 else math.nan


def quotient(a: float, b: float) -> float:
    """Return a / b. The result is infinite if only b is 0, and NaN if both are 0."""
    return a / b if b else math.copysign(math.inf, a) if a else math.nan


@dataclass(frozen=True, kw_only=True)
class Criterion:
    """One inequality: low < value < high. Both bounds are exclusive."""

    what: str
    value: float
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf

    @property
    def holds(self) -> bool:
        return self.low < self.value < self.high

    @property
    def margin(self) -> float | None:
        """The factor between the value and its closer bound. It is below 1 if the value is outside.

        None if the bound is 0: then only the sign of the value counts.
        """
        factors = []
        for bound, sign in ((self.low, 1.0), (self.high, -1.0)):
            if bound == 0.0 or not math.isfinite(bound):
                continue
            if self.value * bound <= 0.0:  # the signs differ
                factors.append(math.inf if sign * (self.value - bound) > 0.0 else 0.0)
            else:
                # With two negative numbers, the greater one has the smaller magnitude.
                factors.append((self.value / bound) ** (sign * math.copysign(1.0, bound)))
        return min(factors, default=None)

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        bounds = []
        if math.isfinite(self.low):
            bounds.append(f"above {self.low:g}")
        if math.isfinite(self.high):
            bounds.append(f"below {self.high:g}")
        factor = "" if self.margin is None else f", margin {self.margin:.3g}"
        failed = "" if self.holds else " FAILS"
        return f"{self.what} {self.value:.2g}{unit} ({' and '.join(bounds)}{factor}){failed}"


def fig_3(runs: Runs) -> list[Criterion]:
    """In continuous time both errors converge. The tracking error is in the order of 1e-4 m."""
    largest = runs["continuous"]["end_effector_position_max"]
    limits = dict.fromkeys(ERRORS, 0.1) | {"base_orientation": 0.2}
    return [
        Criterion(what="end-effector maximum", value=largest, unit="m", low=2e-5, high=9e-4),
        *(_decay(runs["continuous"], error, limit) for error, limit in limits.items()),
    ]


def fig_4(runs: Runs) -> list[Criterion]:
    """With T_b = 0.3 s and without PC, the errors of end-effector and base increase."""
    largest = "end_effector_position_max"
    return [
        Criterion(what="run completed (1: yes)", value=runs["unstable"]["completed"], high=1.0),
        Criterion(what="end of the run", value=runs["unstable"]["end_s"], unit="s", high=100.0),
        Criterion(
            what="distance from a joint limit",
            value=runs["unstable"]["joint_limit_margin_min"],
            unit="rad",
            low=0.0,
        ),
        *(
            Criterion(
                what=f"growth, {name}",
                value=runs["unstable"][f"{error}_growth"],
                unit="1/s",
                low=0.0,
            )
            for error, (name, _) in ERRORS.items()
        ),
        Criterion(
            what="maximum end-effector error / that of Fig. 3",
            value=quotient(runs["unstable"][largest], runs["continuous"][largest]),
            low=3.0,
        ),
    ]


def fig_7(runs: Runs) -> list[Criterion]:
    """Without PC the observed energies of both ports have a negative trend."""
    return [
        criterion
        for port in PORTS
        for criterion in (
            Criterion(
                what=f"{port} minimum",
                value=runs["unstable"][f"{port}_energy_sum_least"],
                unit="J",
                high=0.0,
            ),
            Criterion(
                what=f"{port} trend",
                value=runs["unstable"][f"{port}_energy_sum_early_slope"],
                unit="J/s",
                high=0.0,
            ),
        )
    ]


def fig_8(runs: Runs) -> list[Criterion]:
    """The passivity controllers correct both ports."""
    return [
        Criterion(
            what=f"{port} correction",
            value=runs["passive"][f"{port}_correction_max"],
            unit="N or N m",
            low=low,
        )
        for port, low in zip(PORTS, (1e-3, 1e-2), strict=True)
    ]


def fig_9(runs: Runs) -> list[Criterion]:
    """With PC the observed energies stay positive and have a positive trend.

    A PC acts after the energy has become negative. Therefore the minimum is not exactly 0: it is
    about one sample of the port's power.
    """
    return [
        criterion
        for port in PORTS
        for criterion in (
            Criterion(
                what=f"{port} minimum",
                value=runs["passive"][f"{port}_energy_least"],
                unit="J",
                low=-2e-5,
            ),
            Criterion(
                what=f"{port} trend",
                value=runs["passive"][f"{port}_energy_slope"],
                unit="J/s",
                low=0.0,
            ),
        )
    ]


def fig_10(runs: Runs) -> list[Criterion]:
    """With PC all activity is removed, and the errors converge."""
    limits = {
        "end_effector_position": 0.5,
        "end_effector_orientation": 0.5,
        "base_position": 0.25,
        "base_orientation": 1.0 / 3.0,
    }
    largest = {"end_effector_position": 1e-4, "base_position": 3e-4, "base_orientation": 0.06}
    return [
        Criterion(what="run completed (1: yes)", value=runs["passive"]["completed"], low=0.0),
        *(
            Criterion(
                what=f"{ERRORS[error][0]} at the end",
                value=runs["passive"][f"{error}_end"],
                unit=ERRORS[error][1],
                high=high,
            )
            for error, high in largest.items()
        ),
        *(_decay(runs["passive"], error, limit) for error, limit in limits.items()),
    ]


def _decay(run: Measures, error: str, limit: float) -> Criterion:
    return Criterion(
        what=f"{ERRORS[error][0]}, end / maximum",
        value=quotient(run[f"{error}_end"], run[f"{error}_max"]),
        high=limit,
    )


FIGURES: Mapping[str, Callable[[Runs], list[Criterion]]] = {
    "Fig. 3": fig_3,
    "Fig. 4": fig_4,
    "Fig. 7": fig_7,
    "Fig. 8": fig_8,
    "Fig. 9": fig_9,
    "Fig. 10": fig_10,
}


def by_figure(runs: Runs) -> dict[str, list[Criterion]]:
    """Return the criteria of each figure. `runs` has the measures of each run in RUNS."""
    return {figure: criteria(runs) for figure, criteria in FIGURES.items()}
