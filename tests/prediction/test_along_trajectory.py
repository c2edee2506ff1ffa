"""Growth rate along a motion: comparison with two simulated runs, and with the frozen loop."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_trajectory import OFF, growth_rate

from freeflyer.analysis.prediction.set_point import at_set_point
from freeflyer.analysis.prediction.trajectory import Trajectory
from freeflyer.scenario import scenario

NAME = "multirate_unstable"


def overrides_for(n: int, stop: float) -> list[str]:
    """Return overrides for a whole number of base periods of n ms, up to `stop` [s]."""
    return [
        f"base_controller.period={n / 1000!r}",
        f"stop_s={math.floor(1000 * stop / n) * n / 1000!r}",
    ]


def both(n: int, stop: float) -> tuple[float, float]:
    """Return the predicted and the simulated growth rate [1/s] from the same start."""
    overrides = overrides_for(n, stop)
    with at_set_point(scenario.load(NAME, [*OFF, *overrides])) as here:
        coordinates = here.coordinates(n)
        start = np.random.default_rng(1).normal(size=(24, 1))
        predicted = Trajectory(here.model, coordinates).growth_of(start, n)
    return predicted, growth_rate(NAME, overrides, coordinates)


@pytest.mark.slow
def test_a_perturbation_grows_along_the_motion_as_predicted() -> None:
    """T_b = 0.15 s over 40 s. The operating points are from the run at T_m. The run at T_b differs
    from it by up to 2 deg, which the tolerance covers.
    """
    predicted, simulated = both(150, 40.0)
    print(predicted, simulated)
    assert abs(simulated) > 5e-3
    assert predicted == pytest.approx(simulated, abs=1e-3)


def test_with_a_constant_reference_the_growth_rate_is_that_of_the_set_point() -> None:
    """The growth rate is then ln(radius) / T_b for any interval between linearisations."""
    constant = [
        "reference_trajectory.translation_amplitude=0",
        "reference_trajectory.rotation_amplitude=0",
        "stop_s=60",
    ]
    with at_set_point(scenario.load(NAME, [*OFF, *constant, "base_controller.period=0.3"])) as here:
        trajectory = Trajectory(here.model, here.coordinates(300), 1.0)
        along, own = trajectory.growth_rate(300), here.modes(300)[0].growth_rate
        frozen = trajectory.frozen_growth_rates(300)
    assert frozen == pytest.approx(own, abs=1e-9)
    assert along == pytest.approx(own, abs=1e-9)


@pytest.mark.benchmark
@pytest.mark.parametrize("n", [90, 104, 110, 150])
def test_the_growth_over_100_s_is_the_predicted_one(n: int) -> None:
    predicted, simulated = both(n, 100.0)
    print(f"\nT_b = {n} ms: predicted {predicted:+.5f}, simulated {simulated:+.5f} 1/s")
    assert predicted == pytest.approx(simulated, abs=5e-4)


@pytest.mark.benchmark
def test_a_perturbation_can_decay_although_the_frozen_loop_is_unstable() -> None:
    """T_b = 90 ms: the frozen loop is unstable for a third of the time, but perturbations decay."""
    overrides = overrides_for(90, 100.0)
    with at_set_point(scenario.load(NAME, [*OFF, *overrides])) as here:
        trajectory = Trajectory(here.model, here.coordinates(90))
        along, frozen = trajectory.growth_rate(90), trajectory.frozen_growth_rates(90)
    print(
        f"\nalong {along:+.5f}, frozen up to {frozen.max():+.5f} 1/s, unstable {np.mean(frozen >= 0.0):.0%} of the time"
    )
    assert frozen.max() > 0.0
    assert np.mean(frozen >= 0.0) > 0.25
    assert along < 0.0
