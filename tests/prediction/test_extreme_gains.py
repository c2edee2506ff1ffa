"""Predictions for extreme gains and masses: a result, or one sentence."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run_command

import freeflyer as ff
from freeflyer.analysis.prediction import lifting
from freeflyer.analysis.prediction.predict import Prediction
from freeflyer.analysis.prediction.set_point import at_set_point
from freeflyer.foundation.errors import ScenarioError
from freeflyer.scenario import scenario

NAME = "multirate_unstable"
ARM, BASE = "manipulator_controller", "base_controller"
UNSTABLE = {f"{ARM}.damping": [80.0, 80.0, 80.0, 30.0, 30.0, 30.0]}
LARGEST = 1.7e308

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


def found(changes: dict[str, Any]) -> Prediction:
    """Predict, and check that all numbers of the result are finite."""
    prediction = ff.predict(NAME, changes, longest=0.12)
    json.dumps(prediction.summary(), allow_nan=False)
    prediction.plot()
    assert np.isfinite(prediction.growth_rates).all()
    return prediction


@pytest.fixture(scope="module")
def unstable_end_effector() -> Prediction:
    return found(UNSTABLE)


def test_an_unstable_end_effector_loop_is_a_result(unstable_end_effector: Prediction) -> None:
    limit = unstable_end_effector.limit
    assert limit is not None
    assert unstable_end_effector.largest_stable_s == 0.0
    assert (unstable_end_effector.radius >= 1.0).all()
    assert limit.kind == "hand"
    assert "K_D T_m / 2 M~ = 3.67 in end-effector rotation about (" in limit.description()
    assert "discretisation = matched" in limit.description()


def test_the_ratio_gives_the_multiplier_of_the_end_effector(
    unstable_end_effector: Prediction,
) -> None:
    """The velocity changes by the factor 1 - 2 K_D T_m / (2 M~) per T_m. The spring adds little."""
    ratio = unstable_end_effector.coordinates.fast_damper.ratio
    assert unstable_end_effector.boundary is not None
    assert unstable_end_effector.boundary.multiplier.real == pytest.approx(
        1.0 - 2.0 * ratio, rel=3e-3
    )


@pytest.mark.parametrize("changes", [{"exchange": "parallel"}, {}], ids=["parallel", "sequential"])
@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_the_end_effector_loop_is_unstable_if_the_ratio_is_above_one(
    changes: dict[str, Any], factor: float
) -> None:
    """Without the spring, 1 is the limit of the damper on coupled axes."""
    slack = {**changes, f"{ARM}.stiffness": [0.0] * 6}
    quiet = ff.predict(NAME, slack, longest=0.001).coordinates.fast_damper.ratio
    damping = (np.array([80.0] * 3 + [3.0] * 3) * factor / quiet).tolist()
    at_limit = ff.predict(NAME, {**slack, f"{ARM}.damping": damping}, longest=0.001)
    assert at_limit.coordinates.fast_damper.ratio == pytest.approx(factor)
    assert (at_limit.radius[0] >= 1.0) == (factor > 1.0)


def test_maps_beyond_the_range_of_a_double_have_the_exact_growth_rate() -> None:
    """The maps over few T_m do not overflow. They have nearly the growth rate of the long ones."""
    prediction = found({f"{ARM}.damping": [1e6] * 6})
    assert prediction.radius[-1] > LARGEST
    assert prediction.radius[2] < 1e20
    assert prediction.growth_rates == pytest.approx(prediction.growth_rates[0], rel=1e-3)
    assert prediction.own.growth_rate == pytest.approx(prediction.growth_rates[0], rel=1e-3)
    assert "multiplier above 1.8e+308" in repr(prediction)


def test_the_scaled_map_is_the_map() -> None:
    with at_set_point(scenario.load(NAME)) as here:
        loop = here.loop(20)
        fast, slow = lifting.reduced(loop, lifting.relevant(loop))
        plain = lifting.period_map(fast, slow, 20)
        scaled = lifting.period_map(1e40 * fast, slow, 20)
    assert plain.scale == 0.0
    shift = scaled.scale - 19.0 * math.log(1e40)
    assert scaled.matrix * math.exp(shift) == pytest.approx(plain.matrix, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    "changes",
    [
        {f"{ARM}.damping": [1e300] * 6},
        {f"{ARM}.stiffness": [1e9] * 6},
        {f"{ARM}.damping": [0.0] * 6, f"{ARM}.stiffness": [0.0] * 6},
        {f"{BASE}.damping": [0.0] * 6},
        {f"{BASE}.damping": [1e300] * 6},
        {f"{BASE}.stiffness": [0.0] * 6, f"{BASE}.damping": [0.0] * 6},
        {"robot.base_mass": 1e30},
        {"free_flyer.base_mass": 1e-6},
        {f"{ARM}.damping": [1e300] * 6, f"{ARM}.discretisation": "matched"},
    ],
    ids=str,
)
def test_extreme_values_have_a_result(changes: dict[str, Any]) -> None:
    assert "T_b" in repr(found(changes))


def test_a_loop_beyond_the_range_of_numbers_is_rejected_in_a_sentence() -> None:
    with at_set_point(scenario.load(NAME)) as here:
        loop = here.loop(2)
        light = replace(loop.plant, step_input=1e308 * loop.plant.step_input)
        with pytest.raises(ScenarioError, match="smaller gains, or larger masses"):
            lifting.lifted(replace(loop, plant=light), 2)


def test_a_loop_without_any_gain_is_rejected_in_a_sentence() -> None:
    gains = (f"{one}.{gain}" for one in (ARM, BASE) for gain in ("stiffness", "damping"))
    with pytest.raises(ScenarioError, match="because its gains are zero"):
        found(dict.fromkeys(gains, [0.0] * 6))


def test_the_command_reports_an_unstable_end_effector_loop(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    change = f"{ARM}.damping=[80, 80, 80, 30, 30, 30]"
    code = run_command(capsys, "predict", NAME, "--set", change, "--out", str(tmp_path))[0]
    written = json.loads((tmp_path / "prediction.json").read_text())
    assert code == 0
    assert written["end_effector_loop"]["sampled_damper"] == pytest.approx(3.67, rel=2e-3)
