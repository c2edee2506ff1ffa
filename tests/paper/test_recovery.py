"""The strategy `robust` recovers from strong noise and late base commands, also together.

The runs use the sweep `battery`: its scenario, its named cases and its criterion.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.analysis.sweep import task
from freeflyer.analysis.sweep.designs import NamedDesigns
from freeflyer.paper import battery
from freeflyer.scenario import experiment, scenario
from freeflyer.scenario.scenario import literal

SWEEP = sweep_file.read("battery")
STRATEGY = "robust"


def slow(value: object) -> Any:
    return pytest.param(value, marks=pytest.mark.slow)


def named(name: str) -> Mapping[str, Any]:
    """Return the settings of a named case of the battery."""
    assert isinstance(SWEEP.designs, NamedDesigns)
    return SWEEP.designs.settings[name]


def simulate(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Run the strategy for 200 s with a disturbance. Return the row as in the battery's table."""
    assert not SWEEP.cases[STRATEGY].keys() & settings.keys()
    changes = {**SWEEP.cases[STRATEGY], **settings}
    overrides = [f"{target}={literal(value)}" for target, value in changes.items()]
    result = experiment.run(scenario.load(SWEEP.scenario, [*SWEEP.settings, *overrides]))
    assert result.outcome.simulated == 200.0 or result.outcome.diverged
    return {**task.measured(result), **battery.evaluation.measure(result)}


@pytest.mark.parametrize("seed", [1, slow(2), slow(3), slow(4), slow(5)])
def test_the_loop_is_convergent_with_three_times_the_typical_noise(seed: int) -> None:
    row = simulate({**named("noise x3"), "measurement_noise.seed": seed})
    assert battery.convergent(row), row


@pytest.mark.parametrize("period", [slow(0.15), slow(0.3), slow(0.4), 0.5, slow(0.7), slow(1.0)])
def test_the_loop_is_convergent_with_a_base_command_one_period_late(period: float) -> None:
    row = simulate({**named("delay T_b"), "base_controller.period": period})
    assert battery.convergent(row), row


@pytest.mark.parametrize(
    "other",
    [
        slow("model base x0.7"),
        slow("model base x1.3"),
        "true tool x2.5",
        slow("noise x1"),
        slow("noise x3"),
    ],
)
def test_the_loop_is_convergent_with_a_late_base_command_and_another_disturbance(
    other: str,
) -> None:
    row = simulate({**named("delay T_b"), **named(other)})
    assert battery.convergent(row), row
