"""Set point: the start of a scenario as the operating point of the linearised loop.

The start must be an equilibrium. The controllers must have no memory: their outputs must depend
only on their inputs at the same sample. This module checks both conditions. T_m is the step of the
fast controllers (`loop_roles`).
"""

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
"""The plant is at rest if no state changes faster than this rate [SI unit of the state per s]."""
MEMORY = 1e-9
"""Limit for the ratio of two deviations of a controller's outputs.

The first deviation is measured one sample after a disturbance of the inputs. It is divided by the
second deviation, which is measured during the disturbance. A controller with a larger ratio has
memory.
"""
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
        """Return the linearised loop with a base period of n T_m."""
        return self.model.loop(self.plant, self.point, n * self.model.roles.tick)

    def coordinates(self, n: int) -> TaskCoordinates:
        """Return the task coordinates of the loop with a base period of n T_m."""
        return task_coordinates(self.model, self.loop(n), self.point)

    def radius(self, multipliers: NDArray[np.complex128]) -> float:
        """Return the largest absolute value of the multipliers, without the neutral directions.

        Each neutral direction has the multiplier 1. If there are N neutral directions, the N
        multipliers that are closest to 1 are left out.
        """
        order = np.argsort(np.abs(multipliers - 1.0))
        return float(np.abs(multipliers[order[self.neutral :]]).max())

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
        loop = self.loop(1)
        period_map = lifting.lifted(loop, 1)
        gaps = np.linalg.svd(period_map - np.eye(len(period_map)), compute_uv=False)
        return int(np.count_nonzero(gaps < NEUTRAL))


@contextmanager
def at_set_point(scenario: Scenario, component: str | None = None) -> Iterator[SetPoint]:
    """Open the loop with `linearisation.opened`, and yield its set point. Raises CosimError.

    `component` is the name of the scanned controller (default: the slowest controller).
    """
    with linearisation.opened(scenario, component) as model:
        yield SetPoint(model)


def set_point(model: LoopModel) -> Point:
    """Return the start of the scenario as operating point.

    Raises ScenarioError if the start is not an equilibrium, or if a controller has memory.
    """
    master = model.started(max(model.system.steps.values()), model.roles.tick)
    point = {signal: master.value(signal).copy() for signal in model.recorded()}
    plant = model.fmus[model.roles.plant]
    for name in model.roles.laws:
        _check_memory(model, name, point)
    master.write_inputs_now(model.roles.plant)
    rates = np.abs(plant.rates())
    if rates.max() > REST:
        elements = [name for name in plant.states for _ in range(plant.ports[name].size)]
        raise ScenarioError(
            f"the start is not a set point: {model.roles.plant}.{elements[int(rates.argmax())]} changes by {rates.max():.3g} per second "
            f"(SI units); the robot must start at rest, with its base at the set point of {model.roles.scanned} and its end-effector on the reference"
        )
    return point


def _check_memory(model: LoopModel, name: str, point: Point) -> None:
    """Disturb the inputs of a controller for one sample, and check the outputs at the next sample.

    Raises ScenarioError if the disturbance still affects these outputs.
    """
    fmu, roles = model.fmus[name], model.roles
    names, outputs = model.driven(name), [split(s)[1] for s in model.signals if split(s)[0] == name]
    if not names or not outputs:
        return
    u = np.zeros(sum(fmu.ports[n].size for n in names))
    y = np.zeros(sum(fmu.ports[n].size for n in outputs))
    write, read = fmu.bind_inputs(names, u), fmu.bind_outputs(outputs, y)
    rest = np.concatenate([point[c.source] for c in model.connections_of(name)])
    disturbance = 1e-4 * np.random.default_rng(0).uniform(-1.0, 1.0, u.size)
    sampled = []
    for k, inputs in enumerate((rest, rest + disturbance, rest)):
        u[:] = inputs
        write()
        try:
            fmu.step(seconds(k * roles.tick), seconds(roles.tick))
        except StepFailed as error:
            raise ComponentError(f"component {error}") from error
        read()
        sampled.append(y.copy())
    during, after = np.abs(sampled[1] - sampled[0]), np.abs(sampled[2] - sampled[0])
    if after.max() > MEMORY * during.max():
        worst = [n for n in outputs for _ in range(fmu.ports[n].size)][int(after.argmax())]
        raise ScenarioError(
            f"component {name} has memory: a disturbance of its inputs still affects its output {worst} one sample later; the "
            f"prediction needs controllers without memory, with all passivity controllers switched off"
        )
