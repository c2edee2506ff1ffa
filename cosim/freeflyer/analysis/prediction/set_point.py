"""A scenario's start as an operating point: that it is one, that the controllers are without memory, and the loop around it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from freeflyer.analysis.prediction import lifting, linearisation
from freeflyer.analysis.prediction.lifting import Loop, Plant
from freeflyer.analysis.prediction.linearisation import LoopModel, Point
from freeflyer.analysis.prediction.modes import Mode, modes
from freeflyer.analysis.prediction.task_coordinates import TaskCoordinates, task_coordinates
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import ComponentError, ScenarioError, StepFailed
from freeflyer.foundation.signal_name import split
from freeflyer.scenario.scenario import Scenario

REST = 1e-6
"""Rates of the plant's states [SI] below which it is at rest."""
MEMORY = 1e-9
"""Share of a passed disturbance that may be left in the answer of a component without memory."""
NEUTRAL = 1e-12
"""Singular value of (map - 1) below which the loop does not hold a direction at all."""


class SetPoint:
    """The loop at the set point, ready for any period that is a multiple of T_m."""

    def __init__(self, model: LoopModel) -> None:
        self.model = model
        self.point: Point = set_point(model)
        self.plant: Plant = model.plant_at(self.point)
        self.states = self.plant.A.shape[0]
        self.neutral = self._neutral()

    def loop(self, n: int) -> Loop:
        return self.model.loop(self.plant, self.point, n * self.model.roles.tick)

    def coordinates(self, n: int) -> TaskCoordinates:
        return task_coordinates(self.model, self.loop(n), self.point)

    def radius(self, multipliers: NDArray[np.complex128]) -> float:
        """The largest modulus, the neutral directions' multipliers of 1 apart."""
        order = np.argsort(np.abs(multipliers - 1.0))
        return float(np.abs(multipliers[order[self.neutral :]]).max())

    def modes(self, n: int) -> list[Mode]:
        """The least stable first; see freeflyer.analysis.prediction.modes. Neutral directions are left out."""
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
        loop = self.loop(1)
        period_map = lifting.lifted(loop, 1)
        gaps = np.linalg.svd(period_map - np.eye(len(period_map)), compute_uv=False)
        return int(np.count_nonzero(gaps < NEUTRAL))


@contextmanager
def at_set_point(scenario: Scenario, component: str | None = None) -> Iterator[SetPoint]:
    """See freeflyer.analysis.prediction.linearisation.opened. Raises CosimError."""
    with linearisation.opened(scenario, component) as model:
        yield SetPoint(model)


def set_point(model: LoopModel) -> Point:
    """The start, which must be an equilibrium; ScenarioError if it is none."""
    master = model.started(max(model.system.steps.values()), model.roles.tick)
    point = {signal: master.value(signal).copy() for signal in model.recorded()}
    plant = model.fmus[model.roles.plant]
    for name in model.roles.laws:
        _refuse_memory(model, name, point)
    master.write_inputs_now(model.roles.plant)
    rates = np.abs(plant.rates())
    if rates.max() > REST:
        elements = [name for name in plant.states for _ in range(plant.ports[name].size)]
        raise ScenarioError(
            f"the start is no set point: {model.roles.plant}.{elements[int(rates.argmax())]} changes by {rates.max():.3g} a second "
            f"(SI); let the robot start at rest, its base where base_controller holds it"
        )
    return point


def _refuse_memory(model: LoopModel, name: str, point: Point) -> None:
    """A disturbance of the inputs, at one sample, must be gone from the answer at the next. On an initialised instance."""
    fmu, roles = model.fmus[name], model.roles
    names, outputs = model.driven(name), [split(s)[1] for s in model.signals if split(s)[0] == name]
    if not names or not outputs:
        return
    entry = np.zeros(sum(fmu.ports[n].size for n in names))
    answer = np.zeros(sum(fmu.ports[n].size for n in outputs))
    write, read = fmu.bind_inputs(names, entry), fmu.bind_outputs(outputs, answer)
    rest = np.concatenate([point[c.source] for c in model.connections_of(name)])
    disturbance = 1e-4 * np.random.default_rng(0).uniform(-1.0, 1.0, entry.size)
    answers = []
    for k, given in enumerate((rest, rest + disturbance, rest)):
        entry[:] = given
        write()
        try:
            fmu.step(seconds(k * roles.tick), seconds(roles.tick))
        except StepFailed as error:
            raise ComponentError(f"component {error}") from error
        read()
        answers.append(answer.copy())
    passed, left = np.abs(answers[1] - answers[0]), np.abs(answers[2] - answers[0])
    if left.max() > MEMORY * passed.max():
        worst = [n for n in outputs for _ in range(fmu.ports[n].size)][int(left.argmax())]
        raise ScenarioError(
            f"component {name} has a memory: its output {worst} still shows a disturbance of its inputs that has passed; the "
            f"prediction covers controllers without memory (passivity controllers off)"
        )
