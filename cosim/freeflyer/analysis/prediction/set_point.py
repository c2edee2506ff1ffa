"""Set point: the start of a scenario as the operating point of the linearised loop.

The start must be an equilibrium. The outputs of a controller must depend only on its inputs, and on
a memory whose derivatives its FMU provides (`controller`). This module checks both conditions. T_m
is the step of the fast controllers (`loop_roles`).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from freeflyer.analysis.prediction import lifting, linearisation
from freeflyer.analysis.prediction.lifting import Law, Loop, Plant
from freeflyer.analysis.prediction.linearisation import LoopModel, Point
from freeflyer.analysis.prediction.modes import Mode, modes
from freeflyer.analysis.prediction.task_coordinates import TaskCoordinates, task_coordinates
from freeflyer.foundation.clock import seconds, shown
from freeflyer.foundation.errors import ComponentError, ScenarioError
from freeflyer.scenario.scenario import Scenario

REST = 1e-6
"""The plant is at rest if no state changes faster than this rate [SI unit of the state per s]."""
MEMORY = 1e-9
"""Limit for the effect of an unknown memory of a controller.

The inputs are disturbed for one sample. The effect is the difference of the simulated and the
linearised outputs at later samples, divided by the change of the outputs during the disturbance.
"""
NONLINEAR = 1e-3
"""Largest relative error of the linearised outputs at later samples, for a known memory."""
SAMPLES = 6
"""Number of samples of a simulated response."""
NEUTRAL = 1e-12
"""Limit for singular values of P - 1. P is the map over one period, 1 is the identity matrix.

A direction with a smaller singular value is neutral. In a neutral direction, no force returns the
plant to the set point.
"""


class SetPoint:
    """Linearised loop at the set point, for base periods of n T_m."""

    def __init__(self, model: LoopModel) -> None:
        self.model = model
        self.point: Point = set_point(model)
        self.plant: Plant = model.plant_at(self.point)
        self.states = self.plant.A.shape[0]
        self.neutral = self._neutral()

    def loop(self, n: int) -> Loop:
        """Return the linearised loop with a base period of n T_m.

        Raises ScenarioError if a controller does not accept this period.
        """
        period = n * self.model.roles.tick
        try:
            return self.model.loop(self.plant, self.point, period)
        except ComponentError as error:
            raise ScenarioError(
                f"with the period {shown(period)} of {self.model.roles.scanned}: {error}"
            ) from error

    def coordinates(self, n: int) -> TaskCoordinates:
        """Return the task coordinates of the loop with a base period of n T_m."""
        return task_coordinates(self.model, self.loop(n), self.point)

    def growth(self, multipliers: NDArray[np.complex128], scale: float) -> float:
        """Return ln of the spectral radius: of the largest multiplier that is not neutral.

        The argument `multipliers` is divided by exp(`scale`) (`lifting.PeriodMap`). Each neutral
        direction has the multiplier 1. If there are N neutral directions, the N multipliers that
        are closest to 1 are left out.
        """
        order = np.argsort(np.abs(multipliers - math.exp(-scale)))
        radius = float(np.abs(multipliers[order[self.neutral :]]).max())
        return math.log(max(radius, sys.float_info.min)) + scale

    def modes(self, n: int) -> list[Mode]:
        """Return the modes without the neutral directions. The least stable mode comes first."""
        loop = self.loop(n)
        period = seconds(n * self.model.roles.tick)
        found = modes(
            lifting.lifted(loop, n),
            period,
            task_coordinates(self.model, loop, self.point),
            self.states,
        )
        neutral = sorted(found, key=lambda mode: abs(mode.multiplier - 1.0))[: self.neutral]
        return [mode for mode in found if all(mode is not other for other in neutral)]

    def _neutral(self) -> int:
        n = self.model.shortest
        matrix, scale = lifting.lifted(self.loop(n), n)
        gaps = np.linalg.svd(matrix - math.exp(-scale) * np.eye(len(matrix)), compute_uv=False)
        return int(np.count_nonzero(gaps < NEUTRAL))


@contextmanager
def at_set_point(scenario: Scenario, component: str | None = None) -> Iterator[SetPoint]:
    """Open the loop with `linearisation.opened`, and yield its set point. Raises CosimError.

    `component` is the name of the scanned controller (default: the slowest controller).
    """
    # Overflows have a defined result: `lifting.lifted_maps` handles them.
    quiet = np.errstate(over="ignore", invalid="ignore")
    with linearisation.opened(scenario, component) as model, quiet:
        try:
            yield SetPoint(model)
        except np.linalg.LinAlgError as error:
            raise ScenarioError(
                f"the linearised loop of scenario {scenario.name} cannot be analysed ({error}); gains, masses and inertias of "
                f"similar magnitude are expected"
            ) from error


def set_point(model: LoopModel) -> Point:
    """Return the start of the scenario as operating point.

    Raises ScenarioError if the start is not an equilibrium, or if a controller has a memory that is
    not known.
    """
    master = model.started(model.roles.period, max(model.system.steps.values()), model.roles.tick)
    point = {signal: master.value(signal).copy() for signal in model.recorded()}
    plant = model.fmus[model.roles.plant]
    model.prepare(point)
    loop = model.loop(model.plant_at(point), point, model.roles.period)
    for law in loop.laws:
        _check_memory(model, law, point)
    _check_effect(model, loop)
    master.write_inputs_now(model.roles.plant)
    rates = np.abs(plant.rates())
    if rates.max() > REST:
        elements = [name for name in plant.states for _ in range(plant.ports[name].size)]
        raise ScenarioError(
            f"the start is not a set point: {model.roles.plant}.{elements[int(rates.argmax())]} changes by {rates.max():.3g} per second "
            f"(SI units); the robot must start at rest, with its base at the set point of {model.roles.scanned} and its end-effector on the reference"
        )
    return point


def _check_effect(model: LoopModel, loop: Loop) -> None:
    """Raise ScenarioError if small outputs of the scanned controller do not reach the plant."""
    with_all, with_others = (
        lifting.Instants(each).feedback() for each in (loop, lifting.without_slow_laws(loop))
    )
    if np.array_equal(with_all, with_others):
        raise ScenarioError(
            f"small outputs of {model.roles.scanned} have no effect on {model.roles.plant}, for example because its gains are zero, or because of "
            f"actuators that are on or off; the prediction needs a gain, and actuators without a dead zone"
        )


def _check_memory(model: LoopModel, law: Law, point: Point) -> None:
    """Disturb the inputs of a controller, and check the outputs at later samples.

    The inputs are disturbed for one sample. If a fast controller has a memory, they are also
    disturbed for two periods of the slow controllers, which finds a memory that is written at other
    instants than theirs. Raises ScenarioError if these outputs differ from those of the linearised
    controller.
    """
    if not (law.sample.B.shape[1] and law.sample.C.shape[0]):
        return
    _compare(model, law, point, SAMPLES, 1)
    if len(law.sample.A) and not law.slow:
        count = 2 * model.roles.period // model.roles.tick + SAMPLES
        _compare(model, law, point, count, count)


def _compare(model: LoopModel, law: Law, point: Point, count: int, disturbed: int) -> None:
    """Compare `count` samples of a controller, of which the first `disturbed` are disturbed."""
    disturbance, simulated = model.responses(law.name, point, count, disturbed)
    period, n = model.roles.period, model.roles.period // model.roles.tick
    own = model.period_of(law.name, period)
    z, expected = np.zeros(len(law.sample.A)), []
    for k in range(count):  # the first disturbed sample is the second of the controller
        one = law.sample if own == period or (k + 1) % n == 0 else law.between
        u = disturbance * (k < disturbed)
        expected.append(one.C @ z + one.D @ u)
        z = one.A @ z + one.B @ u
    scale = MEMORY * np.abs(simulated[0]).max() + NONLINEAR * np.abs(expected[1:]).max()
    unknown = np.abs(simulated - expected)[1:].max(axis=0)
    if unknown.max() > scale:
        outputs = model.controllers[law.name].outputs
        worst = [n for n in outputs for _ in range(model.fmus[law.name].ports[n].size)]
        raise ScenarioError(
            f"component {law.name} has memory: a disturbance of its inputs still affects its output {worst[int(unknown.argmax())]} at later "
            f"samples in another way than predicted; the prediction needs controllers without memory, or FMUs of this project with a linear memory that is written at the instants of {model.roles.scanned} or at all instants, and all passivity controllers switched off"
        )
