"""Scan the base period of a loop that is linearised at its set point.

The prediction varies the period of one controller. This controller is called the scanned
controller, and its period is called the base period T_b. The period of the scenario is the value of
T_b in the scenario. The scanned controller is usually the base controller. All other controllers
are called the fast controllers. They have the step T_m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeflyer.analysis.prediction import lifting
from freeflyer.analysis.prediction.modes import LARGEST, Limit, Mode, limit_of
from freeflyer.analysis.prediction.set_point import SetPoint
from freeflyer.analysis.prediction.task_coordinates import TaskCoordinates
from freeflyer.fmi.component import Array
from freeflyer.foundation.clock import nanoseconds, seconds, shown
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.toml_file import as_written

LONGEST = 0.5
"""Default of the longest scanned period [s].

If the period of the scenario is longer than LONGEST, the period of the scenario is the default.
"""
MOST_PERIODS = 100_000
BATCH = 50
"""Number of periods whose eigenvalues are computed in one call."""


@dataclass(frozen=True, kw_only=True)
class Scan:
    """Result of a scan over the base period. Times are in s.

    `scenario` and `component` are the names of the scenario and of the scanned controller. `tick_s`
    is T_m. `period_s` is the period of the scenario. `periods` are the scanned periods. For each
    scanned period, `radius` is the spectral radius of the map over one period, without the neutral
    directions, and `growth_rates` [1/s] is ln(radius) / T_b. A radius above the range of a
    double is replaced by the largest double; its growth rate is exact. `neutral` is the number of
    neutral directions. In a neutral direction, no force returns the plant to the set point: it can
    rest at any position.
    The scan starts at the shortest period that the controllers accept, which is usually T_m.
    `largest_stable_s`: all scanned periods up to this period are stable. It is 0 if the loop is
    unstable with the shortest period. It is the longest scanned period if all periods are stable.
    `stable_s` contains the first and the last period of each stable interval.
    `boundary` is the least stable mode at the first unstable period. `limit` is the cause of this
    instability. `boundary` and `limit` are None if all periods are stable. `own` is the least
    stable mode at the period of the scenario. `coordinates` describe the loop at the first unstable
    period or, if all periods are stable, at the period of the scenario.
    """

    scenario: str
    component: str
    tick_s: float
    period_s: float
    periods: Array
    radius: Array
    growth_rates: Array
    largest_stable_s: float
    stable_s: tuple[tuple[float, float], ...]
    own: Mode
    boundary: Mode | None
    limit: Limit | None
    coordinates: TaskCoordinates
    neutral: int

    @property
    def shortest_s(self) -> float:
        return float(self.periods[0])

    @property
    def longest_s(self) -> float:
        return float(self.periods[-1])

    def summary(self) -> dict[str, Any]:
        """Return the content of prediction.json."""
        return {
            "scenario": self.scenario,
            "component": self.component,
            "fast_period_s": self.tick_s,
            "largest_stable_s": self.largest_stable_s,
            "shortest_scanned_s": self.shortest_s,
            "longest_scanned_s": self.longest_s,
            "stable_s": [list(interval) for interval in self.stable_s],
            "neutral_directions": self.neutral,
            "own_period": _mode_summary(self.own),
            "boundary": self.boundary and _mode_summary(self.boundary),
            "limit": self.limit
            and {
                "kind": self.limit.kind,
                "axis": self.limit.axis,
                "sampled_spring": [_finite(ratio) for ratio in self.limit.spring],
                "sampled_damper": [_finite(ratio) for ratio in self.limit.damper],
            },
            "end_effector_loop": {
                "sampled_damper": self.coordinates.fast_damper.ratio,
                "direction": self.coordinates.fast_damper.direction.tolist(),
            },
            "base": {
                "inertia": self.coordinates.inertia[:6].tolist(),
                "stiffness": self.coordinates.stiffness[:6].tolist(),
                "damping": self.coordinates.damping[:6].tolist(),
            },
            "scan": {
                "period_s": self.periods.tolist(),
                "spectral_radius": self.radius.tolist(),
                "growth_rate_per_s": self.growth_rates.tolist(),
            },
        }


def _finite(ratio: float) -> float | None:
    """Return None for an infinite ratio, because JSON has no infinite numbers."""
    return float(ratio) if math.isfinite(ratio) else None


def _mode_summary(mode: Mode) -> dict[str, Any]:
    return {
        "period_s": mode.period,
        "stable": abs(mode.multiplier) < 1.0,
        "multiplier": [mode.multiplier.real, mode.multiplier.imag],
        "growth_rate_per_s": mode.growth_rate,
        "frequency_hz": mode.frequency,
        "body": mode.body,
        "words": mode.description(),
    }


def scan(here: SetPoint, longest: float | None, *, beyond: bool = True) -> Scan:
    """Scan the period of the loop at a set point. `predict.predict` explains the arguments."""
    # Compute ln of the spectral radius for each period. Each call of `multipliers` handles one
    # batch of periods.
    roles = here.model.roles
    own, count = roles.period // roles.tick, _count(longest, roles.tick, roles.period)
    shortest = here.model.shortest
    if count < shortest:
        raise ScenarioError(
            f"--longest {longest:g}: {shown(shortest * roles.tick)} or more is expected, the shortest period that the controllers accept"
        )
    scanned = range(shortest, count + 1)
    maps, found = lifting.lifted_maps(map(here.loop, scanned), shortest), list[float]()
    while part := list(islice(maps, BATCH)):
        multipliers = lifting.multipliers([one.matrix for one in part])
        found += map(here.growth, multipliers, [one.scale for one in part])
        if not beyond and max(found) >= 0.0:
            break
    # Find the stable intervals and the first unstable mode.
    growth = np.array(found)
    periods = np.array([seconds(n * roles.tick) for n in scanned[: growth.size]])
    stable = growth < 0.0
    unstable = np.flatnonzero(~stable)
    first = scanned[int(unstable[0])] if unstable.size else None
    last = count if first is None else first - 1
    boundary = here.modes(first)[0] if first else None
    coordinates = here.coordinates(first or own)
    return Scan(
        scenario=here.model.scenario.name,
        component=roles.scanned,
        tick_s=seconds(roles.tick),
        period_s=seconds(roles.period),
        periods=periods,
        radius=np.exp(np.minimum(growth, LARGEST)),
        growth_rates=growth / periods,
        largest_stable_s=seconds(last * roles.tick) if last >= shortest else 0.0,
        stable_s=_intervals(periods, stable),
        own=here.modes(own)[0],
        boundary=boundary,
        limit=limit_of(boundary, coordinates, late=here.model.scenario.exchange == "parallel")
        if boundary
        else None,
        coordinates=coordinates,
        neutral=here.neutral,
    )


def _count(longest: float | None, tick: int, period: int) -> int:
    if longest is None:
        return max(nanoseconds(LONGEST, "the longest period") // tick, period // tick, 1)
    if not isinstance(longest, int | float):
        raise ScenarioError(f"longest is {as_written(longest)}; a number in s is expected")
    if not seconds(tick) <= longest:
        raise ScenarioError(
            f"--longest {longest:g}: a time of {shown(tick)} (the fast controllers' step) or more is expected"
        )
    if longest > seconds(MOST_PERIODS * tick):
        raise ScenarioError(
            f"--longest {as_written(longest)}: at most {shown(MOST_PERIODS * tick)} is expected, {MOST_PERIODS} steps of the fast controllers"
        )
    # Round down to a multiple of T_m. The tolerance 1e-6 allows for a rounding error of `longest`.
    return int(longest / seconds(tick) + 1e-6)


def _intervals(periods: Array, stable: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stable, [False]]).astype(int)))
    return tuple(
        (float(periods[a]), float(periods[b - 1]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    )
