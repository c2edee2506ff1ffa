"""Stability along a trajectory: growth rate of small perturbations.

The loop is linearised at many points in time, the linearisation points. T_m is the step of the fast
controllers, and T_b is the base period, the period of the scanned controller (`loop_roles`). A
tangent map is the linear map of a small perturbation over one base period. The frozen loop at a
linearisation point is the loop whose coefficients stay constant at their values at this point.
The eigenvalues of the frozen loops do not determine the stability of a time-varying loop. The
time-varying loop can be unstable although all these eigenvalues are inside the unit circle. It can
also be stable although some of these eigenvalues are outside the unit circle.
The Floquet multipliers determine the stability. They are the eigenvalues of the product of the
tangent maps along the motion. The product is taken over the second half of the run, as if the
motion in this half were repeated periodically. Therefore the length of this half should be a
multiple of the period of the motion, with an error of at most one T_b.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from freeflyer.analysis.prediction import lifting
from freeflyer.analysis.prediction.lifting import Loop, Sample
from freeflyer.analysis.prediction.linearisation import LoopModel, Point
from freeflyer.analysis.prediction.task_coordinates import TaskCoordinates
from freeflyer.fmi.component import Array
from freeflyer.foundation.clock import nanoseconds, seconds
from freeflyer.foundation.errors import ScenarioError

CELL = 0.05
"""Interval [s] between two linearisation points. It is called a cell.

The coefficients of the loop are assumed to be constant for half a cell before and after a point.
"""

LEAST_PERIODS = 8
"""Minimum number of base periods in a run. Growth rates are computed from the second half."""

Progress = Callable[[float], None]
"""Function that is called with the completed fraction of the work."""


@dataclass(frozen=True, kw_only=True)
class AlongTrajectory:
    """Result of the analysis along a trajectory. Times are in s.

    `period_s` is the base period of the scenario. `growth_rate` [1/s] is the growth rate with this
    period, between the times `from_s` and `to_s`. `largest_stable_s` is the largest stable base
    period. It is found by bisection. The bisection assumes that there is only one stability
    boundary. `largest_stable_s` is 0 if no stable period is found. `frozen_growth_rate` [1/s] is
    the largest growth rate of the frozen loops. It occurs at the time `frozen_at_s`.
    `frozen_unstable` is the fraction of the linearisation points at which the frozen loop is
    unstable.
    """

    period_s: float
    from_s: float
    to_s: float
    growth_rate: float
    largest_stable_s: float
    frozen_growth_rate: float
    frozen_at_s: float
    frozen_unstable: float

    def summary(self) -> dict[str, Any]:
        """Return the result for prediction.json."""
        return {
            "period_s": self.period_s,
            "from_s": self.from_s,
            "to_s": self.to_s,
            "growth_rate_per_s": self.growth_rate,
            "largest_stable_s": self.largest_stable_s,
            "frozen_growth_rate_per_s": self.frozen_growth_rate,
            "frozen_growth_rate_at_s": self.frozen_at_s,
            "frozen_unstable_share": self.frozen_unstable,
        }


class Trajectory:
    """Linearisations of the plant along a run with the shortest period of the scanned controller.

    With this period (`LoopModel.shortest`), the motion is closest to the desired motion.
    """

    def __init__(self, model: LoopModel, coordinates: TaskCoordinates, cell: float = CELL) -> None:
        """Run the scenario, and linearise the plant every `cell` [s].

        `coordinates` gives the energy of a perturbation. Raises ScenarioError if the run stops
        early.
        """
        self.model, self._coordinates, tick = model, coordinates, model.roles.tick
        self.cell = max(nanoseconds(cell, "the cell") // tick, 1)  # in units of T_m
        cells = model.scenario.stop // tick // self.cell
        self.ticks = cells * self.cell
        outcome = model.started(model.shortest * tick, self.ticks * tick, self.cell * tick).run()
        if outcome.interrupted:
            raise KeyboardInterrupt
        if outcome.cause:
            raise ScenarioError(
                f"scenario {model.scenario.name}: the run stops at {outcome.simulated:g} s ({outcome.cause}), even with a base period of "
                f"{seconds(model.shortest * tick):g} s; therefore there is no trajectory for the prediction"
            )
        record = outcome.record
        self.points: list[Point] = [
            {signal: np.atleast_1d(record[signal][row]) for signal in model.recorded()}
            for row in range(cells + 1)
        ]
        self.plants = [model.plant_at(point) for point in self.points]
        self._charts = [model.chart(point) for point in self.points]
        self._moves = [back @ into for (into, _), (_, back) in pairwise(self._charts)]

    def loops(self, n: int) -> list[Loop]:
        """Return the linearised loop at each linearisation point, with a base period of n T_m."""
        period = n * self.model.roles.tick
        return [
            self.model.loop(plant, point, period)
            for plant, point in zip(self.plants, self.points, strict=True)
        ]

    def growth_rate(self, n: int, loops: Sequence[Loop] | None = None) -> float:
        """Return the growth rate [1/s] with a base period of n T_m.

        P is the product of the tangent maps over the second half of the run. The growth rate is
        ln(spectral radius of P) / (length of the second half). `loops` are the results of
        `self.loops(n)`, if the caller has them. The growth rates of two modes can differ by less
        than 1 / length. The eigenvalues of P separate such modes. A fit to the size of a
        perturbation, as in `growth_of`, does not separate them.
        """
        loops = loops or self.loops(n)
        periods, kept = self.ticks // n, _relevant(loops)
        first = periods // 2
        *_, (vectors, scale) = self._product(n, loops, kept, np.eye(kept.size), first)
        states, ends = (
            self.plants[0].A.shape[0],
            (self._cell(first * n), self._cell(periods * n - 1)),
        )
        # Transform the result back to the tangent chart of the first linearisation point.
        vectors[:states] = self._charts[ends[0]][1] @ self._charts[ends[1]][0] @ vectors[:states]
        radius = float(np.abs(np.linalg.eigvals(vectors)).max())
        return (math.log(radius) + scale) / ((periods - first) * n * seconds(self.model.roles.tick))

    def growth_of(self, starts: Array, n: int) -> float:
        """Return the growth rate [1/s] that a simulation shows after perturbations of the start.

        The growth rate is the slope of ln sqrt(E) over the second half of the run. E is the energy
        of all perturbations together. Each column of `starts` is one perturbation of the plant's
        states, in chart coordinates. The base period is n T_m.
        """
        loops = self.loops(n)
        states, kept = self.plants[0].A.shape[0], _relevant(loops)
        vectors = np.zeros((kept.size, starts.shape[1]))
        vectors[:states] = starts
        sizes = np.array(
            [
                scale + 0.5 * math.log(self._energy(v[:states]).sum())
                for v, scale in self._product(n, loops, kept, vectors, 0)
            ]
        )
        late = np.arange(sizes.size // 2, sizes.size)
        return float(np.polyfit(late * n * seconds(self.model.roles.tick), sizes[late], 1)[0])

    def _cell(self, tick: int) -> int:
        return (tick + self.cell // 2) // self.cell

    def _product(
        self, n: int, loops: Sequence[Loop], kept: lifting.Indices, vectors: Array, first: int
    ) -> Iterator[tuple[Array, float]]:
        """Propagate the columns of `vectors` from base period `first` to the end of the run.

        Each row of `vectors` is an element of the loop's state. `kept` contains the indices of
        these elements. After each period, the vectors are divided by their largest element. Yields
        the scaled vectors, and ln of the product of all divisors.
        """
        maps = [lifting.reduced(loop, kept) for loop in loops]
        states, place, scale = self.plants[0].A.shape[0], self._cell(first * n), 0.0
        for k in range(first, self.ticks // n):
            for at in range(k * n, (k + 1) * n):
                cell = self._cell(at)
                while place < cell:  # change to the tangent chart of the next linearisation point
                    vectors[:states] = self._moves[place] @ vectors[:states]
                    place += 1
                vectors = maps[cell][at == k * n] @ vectors
            size = float(np.abs(vectors).max())
            vectors, scale = vectors / size, scale + math.log(size)
            yield vectors, scale

    def _energy(self, vectors: Array) -> Array:
        return np.asarray(self._coordinates.energy(vectors).sum(axis=0))

    def frozen_growth_rates(self, n: int, loops: Sequence[Loop] | None = None) -> Array:
        """Return ln(spectral radius) / T_b [1/s] of the frozen loop at each linearisation point.

        The base period T_b is n T_m. `loops` are the results of `self.loops(n)`, if the caller has
        them.
        """
        loops = loops or self.loops(n)
        kept = _relevant(loops)
        maps = [lifting.period_map(*lifting.reduced(loop, kept), n) for loop in loops]
        radius = [np.abs(z).max() for z in lifting.multipliers([one.matrix for one in maps])]
        growth = np.log(radius) + [one.scale for one in maps]
        return np.asarray(growth / (n * seconds(self.model.roles.tick)))

    def largest_stable(self, first: int, longest: int, progress: Progress | None = None) -> int:
        """Return the largest stable n up to `longest`, by bisection from the guess `first`.

        The base period is n T_m. The result is 0 if no stable period is found. The error of the
        result is at most 1 % or one T_m, whichever is larger.
        """
        none, above = self.model.shortest - 1, longest + 1
        below, n = none, min(max(first, none + 1), longest)
        step, count = max(n // 10, 1), 0
        while above - below > max(1, below // 100):
            if self.growth_rate(n) < 0.0:
                below, n = n, n + step if above > longest else (n + above) // 2
            else:
                above, n = n, n - step if below == none else (n + below) // 2
            n, step = min(max(n, below + 1), above - 1), 2 * step
            count += 1
            if progress:
                progress(1.0 - 1.0 / (1.0 + 0.3 * count))
        return below if below > none else 0


def _relevant(loops: Sequence[Loop]) -> lifting.Indices:
    """Return the indices of the elements that are relevant in at least one of the loops.

    `lifting.relevant` defines the relevant elements. A single loop is not sufficient, because one
    of its gains can be 0 by chance.
    """
    first = loops[0]
    laws = [
        replace(
            law,
            sample=_largest([loop.laws[k].sample for loop in loops]),
            between=_largest([loop.laws[k].between for loop in loops]),
        )
        for k, law in enumerate(first.laws)
    ]
    C, step, step_input = (
        _magnitude([getattr(loop.plant, part) for loop in loops])
        for part in ("C", "step", "step_input")
    )
    plant = replace(first.plant, C=C, step=step, step_input=step_input)
    return lifting.relevant(replace(first, plant=plant, laws=tuple(laws)))


def _largest(samples: Sequence[Sample]) -> Sample:
    A, B, C, D = (_magnitude(part) for part in zip(*(s.matrices for s in samples), strict=True))
    return Sample(A=A, B=B, C=C, D=D)


def _magnitude(matrices: Sequence[Array]) -> Array:
    return np.asarray(np.abs(np.stack(matrices)).sum(axis=0))


def check_length(model: LoopModel) -> None:
    """Raise ScenarioError if the scenario is too short for the computation of a growth rate."""
    stop, needed = (
        seconds(model.scenario.stop),
        max(LEAST_PERIODS * seconds(model.roles.period), 4.0 * CELL),
    )
    if stop < needed:
        raise ScenarioError(
            f"stop_s is {stop:g} s; along a trajectory {needed:g} s or more are expected (at least {LEAST_PERIODS} base periods)"
        )


def along_trajectory(
    model: LoopModel,
    coordinates: TaskCoordinates,
    guess: float,
    longest: float,
    progress: Progress | None = None,
) -> AlongTrajectory:
    """Analyse the loop with the period of the scenario, and search the stability boundary.

    The boundary is searched between the shortest period and `longest` [s]. The search starts at
    `guess` [s].
    Raises CosimError.
    """
    check_length(model)
    trajectory = Trajectory(model, coordinates)
    roles = model.roles
    tick, n = roles.tick, roles.period // roles.tick
    periods = trajectory.ticks // n
    loops = trajectory.loops(n)
    frozen = trajectory.frozen_growth_rates(n, loops)
    first, last = (math.floor(time / seconds(tick) + 0.5) for time in (guess, longest))
    return AlongTrajectory(
        period_s=seconds(roles.period),
        from_s=seconds(periods // 2 * roles.period),
        to_s=seconds(periods * roles.period),
        growth_rate=trajectory.growth_rate(n, loops),
        largest_stable_s=seconds(
            tick
            * trajectory.largest_stable(
                first, min(last, trajectory.ticks // LEAST_PERIODS), progress
            )
        ),
        frozen_growth_rate=float(frozen.max()),
        frozen_at_s=seconds(int(frozen.argmax()) * trajectory.cell * tick),
        frozen_unstable=float(np.mean(frozen >= 0.0)),
    )
