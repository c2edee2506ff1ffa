"""Simulated and predicted stability boundary for random gains.

The simulated growth rate is fitted to the growth of a small perturbation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from simulated_period import POSTURE, QUIET, STATES, Array, starting_at

from freeflyer.analysis.prediction import lifting
from freeflyer.analysis.prediction.boundary import scan
from freeflyer.analysis.prediction.set_point import SetPoint, at_set_point
from freeflyer.analysis.prediction.task_coordinates import TaskCoordinates
from freeflyer.scenario import scenario
from freeflyer.scenario.assemble import assembled

Overrides = Callable[[int], tuple[str, list[str]]]
"""Function of a seed: the name of a scenario, and its overrides."""
PERTURBATION = 1e-6
DURATION = 80.0
LONGEST = 1.0


@dataclass(frozen=True, kw_only=True)
class Side:
    """One base period of n T_m: predicted and simulated growth rates [1/s]."""

    n: int
    predicted: float
    simulated: float


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Growth rates below and above the predicted boundary of `predicted` T_m, at the tolerance.

    The simulation agrees if its boundary lies between `below` and `above`.
    """

    seed: int
    predicted: int
    limit: str
    below: Side
    above: Side

    @property
    def agrees(self) -> bool:
        return self.below.simulated < 0.0 <= self.above.simulated

    def __str__(self) -> str:
        sides = "  ".join(
            f"{s.n:4d}: {s.simulated:+.5f} ({s.predicted:+.5f})" for s in (self.below, self.above)
        )
        return f"{self.seed:3d}  {self.predicted:4d} ms  {sides}  {self.limit}"


def random_gains(seed: int) -> tuple[str, list[str]]:
    """Return overrides with random gains per axis; those of the base vary by more than a decade."""
    return "multirate_unstable", gains(seed)


def random_memories(seed: int) -> tuple[str, list[str]]:
    """Return overrides with random gains, laws, masses, filter and delays of the robust loop."""
    random = np.random.default_rng([seed, 18])
    late = random.choice(["on time", "late", "late, predicted"], p=[0.2, 0.2, 0.6])
    delay = 0.0 if late == "on time" else "=base_controller.period"
    law = random.choice(["emulated", "matched"])
    factor = random.uniform(0.4, 1.6)
    chosen = {
        "base_controller.discretisation": law,
        "manipulator_controller.discretisation": law,
        "manipulator_controller.filter_time": round(random.uniform(0.005, 0.03), 4),
        "manipulator_controller.filter_without_lag": str(random.random() < 0.5).lower(),
        "base_command_delay.delay": delay,
        "base_controller.command_delay": delay if late == "late, predicted" else 0.0,
        "arm_command_delay.delay": random.choice([0.0, 0.001]),
        "base_controller.base_mass": round(150.0 * factor, 1),
        "base_controller.base_inertia": [
            round(factor * own, 2) for own in (38.0, 20.0, 23.0, 0.0, 0.0, 0.0)
        ],
    }
    return "disturbed", [*gains(seed), *(f"{name}={value}" for name, value in chosen.items())]


def gains(seed: int) -> list[str]:
    random = np.random.default_rng(seed)

    def drawn(least: tuple[float, float], most: tuple[float, float]) -> list[float]:
        centre = [
            math.exp(random.uniform(math.log(a), math.log(b)))
            for a, b in zip(least, most, strict=True)
        ]
        return [round(float(c * random.uniform(0.7, 1.4)), 3) for c in centre for _ in range(3)]

    return [
        f"base_controller.stiffness={drawn((50.0, 10.0), (500.0, 100.0))}",
        f"base_controller.damping={drawn((5.0, 1.0), (600.0, 120.0))}",
        f"manipulator_controller.stiffness={drawn((200.0, 20.0), (1000.0, 100.0))}",
        f"manipulator_controller.damping={drawn((40.0, 1.5), (160.0, 5.0))}",
    ]


def comparisons(drawn: Overrides, tolerance: float) -> Iterator[Comparison]:
    """Yield the comparisons of all seeds whose predicted boundary lies within the scan."""
    seed = 0
    while True:
        found = compared(seed, drawn, tolerance)
        if found:
            yield found
        seed += 1


def compared(seed: int, drawn: Overrides, tolerance: float = 0.02) -> Comparison | None:
    """Return a comparison, or None if the loop is stable, or unstable, at all scanned periods.

    The periods are compared at `tolerance` times the boundary, or at one T_m if this is larger.
    """
    name, own = drawn(seed)
    overrides = [*QUIET, *own]
    with at_set_point(scenario.load(name, overrides)) as here:
        prediction = scan(here, LONGEST, beyond=False)
        n = round(prediction.largest_stable_s / prediction.tick_s)
        off = max(int(tolerance * n), 1)
        if not prediction.boundary or not prediction.limit or n - off < here.model.shortest:
            return None
        # The first unstable period is n + 1.
        below, above = (
            side(here, prediction.coordinates, overrides, k, seed) for k in (n - off, n + off + 1)
        )
    return Comparison(seed=seed, predicted=n, limit=prediction.limit.kind, below=below, above=above)


def side(
    here: SetPoint, coordinates: TaskCoordinates, overrides: list[str], n: int, seed: int
) -> Side:
    """Return both growth rates with a base period of n T_m."""
    values, vectors = np.linalg.eig(lifting.lifted(here.loop(n), n).matrix)
    worst = int(np.abs(values).argmax())
    # Start along the predicted mode, which then dominates from the start, plus 1 % in a random
    # direction.
    start, rest = vectors[:24, worst].real, np.random.default_rng(seed).normal(size=24)
    start = start / np.linalg.norm(start) + 0.01 * rest / np.linalg.norm(rest)
    name = here.model.scenario.name
    rate = fitted_growth(name, overrides, PERTURBATION * start, n, coordinates)
    return Side(n=n, predicted=math.log(abs(values[worst])) / (1e-3 * n), simulated=rate)


def fitted_growth(
    name: str, overrides: list[str], start: Array, n: int, coordinates: TaskCoordinates
) -> float:
    """Return the growth rate [1/s]: the slope of ln sqrt(energy) at the base's samples.

    The fit uses the second half of the run, or of the part before the perturbation has grown by a
    factor of 1000.
    """
    period = n * 1e-3
    stop = round(DURATION / period) * n / 1000
    times = [
        f"base_controller.period={n / 1000!r}",
        f"record.every_s={n / 1000!r}",
        f"stop_s={stop!r}",
    ]
    chosen = scenario.load(name, [*overrides, *starting_at(start), *times])
    with assembled(chosen) as (master, _):
        record = master.run().record
    rest = (np.zeros(3), np.array([0.0, 0.0, 0.0]), np.zeros(6), POSTURE, np.zeros(6))
    columns = [record[f"free_flyer.{name}"] for name in STATES]
    columns[1] = 2.0 * columns[1][:, :3]  # a small rotation vector
    x = np.hstack([column - zero for column, zero in zip(columns, rest, strict=True)])
    size = 0.5 * np.log(coordinates.energy(x.T).sum(axis=0))
    grown = np.flatnonzero(size > size[0] + math.log(1e3))
    end = int(grown[0]) if grown.size else size.size
    late = slice(end // 2, end)
    return float(np.polyfit(record.time[late], size[late], 1)[0])
