"""Predictions for loops with known or simulated stability limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from families import family
from simulated_boundary import (
    Overrides,
    compared,
    comparisons,
    random_gains,
    random_memories,
    side,
)
from simulated_period import QUIET

from freeflyer.analysis.prediction import linearisation
from freeflyer.analysis.prediction.boundary import scan
from freeflyer.analysis.prediction.modes import DEGREES
from freeflyer.analysis.prediction.predict import Prediction, predict
from freeflyer.analysis.prediction.set_point import at_set_point
from freeflyer.scenario import scenario

NAME = "multirate_unstable"


@pytest.fixture(scope="module")
def default() -> Prediction:
    return predict(scenario.load(NAME))


def test_the_default_gains_are_stable_to_98_ms(default: Prediction) -> None:
    """docs/prediction.md and an independent prototype give about 98 ms."""
    assert default.largest_stable_s == pytest.approx(0.098, abs=1e-3)
    assert default.stable_s == ((0.001, default.largest_stable_s),)
    assert default.own.growth_rate > 0.0


def test_the_default_gains_are_limited_by_the_sampled_spring(default: Prediction) -> None:
    assert default.limit is not None
    assert default.boundary is not None
    assert default.limit.kind == "sampled spring"
    assert default.boundary.body == "base"
    assert default.boundary.oscillates
    assert "sampled spring" in default.limit.description()
    assert default.limit.axis in default.boundary.description()


def test_too_much_damping_is_limited_by_the_sampled_damper() -> None:
    overdamped = predict(scenario.load("overdamped_base"))
    assert overdamped.limit is not None
    assert overdamped.boundary is not None
    assert overdamped.limit.kind == "sampled damper"
    assert overdamped.boundary.alternates
    assert overdamped.boundary.multiplier.real < -1.0
    assert overdamped.largest_stable_s < 0.5
    assert overdamped.own.growth_rate > 0.0


def test_damping_helps_a_sampled_spring_and_harms_a_sampled_damper(default: Prediction) -> None:
    more = predict(scenario.load(NAME, ["base_controller.damping=[15, 15, 15, 3, 3, 3]"]))
    assert more.largest_stable_s == pytest.approx(1.5 * default.largest_stable_s, rel=0.02)
    rates = []
    for factor in (1.0, 1.1):
        damping = [400.0 * factor] * 3 + [100.0 * factor] * 3
        rates.append(
            predict(
                scenario.load("overdamped_base", [f"base_controller.damping={damping}"])
            ).largest_stable_s
        )
    assert rates[1] == pytest.approx(rates[0] / 1.1, rel=0.02)


@pytest.mark.parametrize("name", [NAME, "overdamped_base"])
def test_matched_gains_have_no_boundary_within_the_scan(name: str) -> None:
    matched = predict(scenario.load(name, ["base_controller.discretisation=matched"]))
    assert matched.boundary is None
    assert matched.limit is None
    assert matched.largest_stable_s == matched.longest_s == 0.5
    assert matched.own.growth_rate < 0.0


def test_parallel_exchange_has_a_third_of_the_period(default: Prediction) -> None:
    """The base's wrench is delayed by T_b. The mean delay of the spring is 3/2 T_b, not T_b / 2."""
    parallel = predict(scenario.load(NAME, ["exchange=parallel"]))
    assert parallel.largest_stable_s == pytest.approx(default.largest_stable_s / 3.0, rel=0.05)
    assert parallel.limit is not None
    assert parallel.limit.kind == "sampled spring"


def test_both_fmi_versions_predict_the_same(default: Prediction) -> None:
    chosen = scenario.load(NAME)
    fmi3 = tuple(replace(spec, options={**spec.options, "fmi": 3}) for spec in chosen.components)
    assert np.array_equal(predict(replace(chosen, components=fmi3)).radius, default.radius)


def test_a_scan_that_stops_at_the_boundary_finds_the_same_boundary(default: Prediction) -> None:
    short = predict(scenario.load(NAME), beyond=False)
    assert short.largest_stable_s == default.largest_stable_s
    assert short.longest_s < default.longest_s
    assert np.array_equal(short.radius, default.radius[: short.radius.size])


def test_the_passivity_controllers_are_off_in_the_prediction(default: Prediction) -> None:
    assert np.array_equal(predict(scenario.load("multirate_passive")).radius, default.radius)


def test_the_linear_loop_reproduces_the_given_gains(default: Prediction) -> None:
    given = (
        [150.0] * 3 + [40.0] * 3 + [500.0] * 3 + [50.0] * 3,
        [10.0] * 3 + [2.0] * 3 + [80.0] * 3 + [3.0] * 3,
    )
    assert default.coordinates.stiffness == pytest.approx(given[0], rel=1e-6)
    assert default.coordinates.damping == pytest.approx(given[1], rel=1e-6)


def test_an_axis_without_stiffness_is_neutral_and_excluded(default: Prediction) -> None:
    free = predict(scenario.load(NAME, ["base_controller.stiffness=[0, 150, 150, 40, 40, 40]"]))
    assert free.neutral == 1
    assert default.neutral == 0
    assert 0.05 < free.largest_stable_s < 0.2
    assert (free.radius[: round(free.largest_stable_s / free.tick_s)] < 1.0).all()


def test_energy_shares_add_up_to_one_and_the_description_lists_the_largest_first(
    default: Prediction,
) -> None:
    assert default.boundary is not None
    assert default.boundary.shares.sum() == pytest.approx(1.0)
    assert default.boundary.description().startswith(DEGREES[int(default.boundary.shares.argmax())])


def test_the_plants_matrices_are_the_derivatives_of_its_rates() -> None:
    """Compares A and B at the set point with central differences of the FMU's state derivatives."""
    with at_set_point(scenario.load(NAME)) as here:
        model, point, plant = here.model, here.point, here.plant
        fmu, values = model.fmus["free_flyer"], model.system.values["free_flyer"]
        into, back = model.chart(point)
        driven = model.driven("free_flyer")
        sizes = [fmu.ports[name].size for name in driven]

        def rates(x: np.ndarray, u: np.ndarray) -> np.ndarray:
            whole = np.concatenate([point[f"free_flyer.{name}"] for name in fmu.states]) + into @ x
            ends = np.cumsum([fmu.ports[name].size for name in fmu.states])[:-1]
            inputs = dict(zip(driven, np.split(u, np.cumsum(sizes)[:-1]), strict=True))
            fmu.restart(
                {**values, **dict(zip(fmu.states, np.split(whole, ends), strict=True)), **inputs}
            )
            return np.asarray(back @ fmu.rates())

        h, x0, u0 = 1e-5, np.zeros(24), np.zeros(sum(sizes))
        A = np.array([(rates(h * e, u0) - rates(-h * e, u0)) / (2.0 * h) for e in np.eye(24)]).T
        B = np.array(
            [(rates(x0, h * e) - rates(x0, -h * e)) / (2.0 * h) for e in np.eye(u0.size)]
        ).T
    assert np.abs(A - plant.A).max() < 1e-7
    assert np.abs(B - plant.B).max() < 1e-7 * np.abs(plant.B).max()


def test_components_without_connections_are_not_part_of_the_loop() -> None:
    with linearisation.opened(scenario.load("continuous")) as model:
        assert "continuous_loop" not in model.fmus
        assert model.roles.scanned == "base_controller"


@pytest.mark.parametrize("seed", family([0, 5, 16]))
def test_the_simulated_boundary_is_the_predicted_one(seed: int) -> None:
    """Three of the fifty sets below: one sampled damper and two sampled springs."""
    found = compared(seed, random_gains)
    assert found is not None
    assert found.agrees, found


@pytest.mark.slow
@pytest.mark.parametrize("seed", family([2, 7]))
def test_the_simulated_boundary_of_controllers_with_memory_is_the_predicted_one(seed: int) -> None:
    """Within one T_m: a filter and a predicted delay."""
    found = compared(seed, random_memories, tolerance=0.0)
    assert found is not None
    assert found.agrees, found


def test_the_robust_loop_is_predicted_from_the_shortest_period_of_its_filter() -> None:
    found = predict(scenario.load("robust"))
    assert found.shortest_s == 0.03
    assert found.boundary is None
    assert found.coordinates.stiffness[:6] == pytest.approx([150.0] * 3 + [40.0] * 3, rel=0.15)


def test_a_late_command_is_unstable_unless_the_controller_predicts_over_it() -> None:
    late = ["base_command_delay.delay==base_controller.period"]
    assert predict(scenario.load("disturbed", late), longest=0.35).boundary is None
    unaware = [*late, "base_controller.command_delay=0"]
    assert predict(scenario.load("disturbed", unaware), longest=0.35).largest_stable_s == 0.048
    # The lag of the filter takes the rest of the damping.
    lagging = [*unaware, "manipulator_controller.filter_without_lag=false"]
    found = predict(scenario.load("disturbed", lagging), longest=0.35)
    assert found.largest_stable_s == 0.0
    assert found.own.growth_rate == pytest.approx(0.233, rel=0.01)


@pytest.mark.slow
def test_the_simulation_confirms_a_stable_interval_above_the_first_boundary() -> None:
    """Stability is not monotone for a well damped base and a weakly damped end-effector.

    The loop is unstable from 0.6 s, then stable again, then unstable.
    """
    weakly_damped = [
        *QUIET,
        "base_controller.damping=[60, 60, 60, 15, 15, 15]",
        "manipulator_controller.damping=[1, 1, 1, 0.05, 0.05, 0.05]",
    ]
    with at_set_point(scenario.load(NAME, weakly_damped)) as here:
        prediction = scan(here, 0.8)
        assert len(prediction.stable_s) == 2
        (_, first), (again, last) = prediction.stable_s
        assert prediction.largest_stable_s == first < again < last < prediction.longest_s
        for n, stable in (
            (round(500 * (first + again)), False),
            (round(500 * (again + last)), True),
            (800, False),
        ):
            found = side(here, prediction.coordinates, weakly_damped, n, seed=1)
            assert (found.simulated < 0.0) == (found.predicted < 0.0) == stable


@pytest.mark.benchmark
@pytest.mark.parametrize(
    ("drawn", "tolerance", "absolute"), [(random_gains, 0.02, 1e-4), (random_memories, 0.0, 7e-4)]
)
def test_the_simulated_boundary_is_the_predicted_one_in_fifty_random_sets(
    drawn: Overrides, tolerance: float, absolute: float
) -> None:
    """Compares boundaries at the tolerance or one T_m, and growth rates of a 1e-6 perturbation."""
    agreeing = 0
    print(
        "\nset  predicted  n: simulated (predicted) growth rate [1/s] below and above  limited by"
    )
    for found, _ in zip(comparisons(drawn, tolerance), range(50), strict=False):
        print(found, "" if found.agrees else "DIFFERS", flush=True)
        agreeing += found.agrees
        for each in (found.below, found.above):
            assert each.simulated == pytest.approx(each.predicted, rel=0.05, abs=absolute), found
    assert agreeing == 50
