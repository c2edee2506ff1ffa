"""Criteria of the paper's statements: they hold with three sets, and none of them is empty."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import casadi as ca
import numpy as np
import pytest
from families import family
from hypothesis import given
from hypothesis import strategies as st

from freeflyer.paper import criteria, statements
from freeflyer.paper.criteria import Criterion, Measures
from freeflyer.scenario import experiment, scenario
from freeflyer_fmus.equations.kinematics import end_effector_pose
from freeflyer_fmus.equations.mechanism import constant_mechanism
from freeflyer_fmus.robot.urdf import load_robot_file

PC_RUNS = ("unstable", "passive")
DEFAULT_GAINS = (
    "manipulator_controller.stiffness=[500, 500, 500, 50, 50, 50]",
    "manipulator_controller.damping=[80, 80, 80, 3, 3, 3]",
    "base_controller.stiffness=[150, 150, 150, 40, 40, 40]",
    "base_controller.damping=[10, 10, 10, 2, 2, 2]",
)
# A change of the set `paper`, the runs that it changes, and the figures whose statement then fails.
CHANGES = {
    "the gains of multirate_passive": (DEFAULT_GAINS, criteria.RUNS, "3 4 7 9 10"),
    "a short base period": (("base_controller.period=0.01",), PC_RUNS, "4 7 8"),
    "a long base period": (("base_controller.period=0.6",), PC_RUNS, "9 10"),
    "twice the amplitude": (
        ("reference_trajectory.translation_amplitude=[0.28, 0, 0]",),
        criteria.RUNS,
        "3 4 9 10",
    ),
    "half the amplitude": (
        ("reference_trajectory.translation_amplitude=[0.07, 0, 0]",),
        criteria.RUNS,
        "7 8",
    ),
    "five times the start offset": (
        ("reference_trajectory.start_offset=[5e-4, 15e-4, -10e-4, 0, 0, 0]",),
        criteria.RUNS,
        "3 4 7",
    ),
    "no damping of the end-effector": (
        ("manipulator_controller.damping=0",),
        criteria.RUNS,
        "3 4 7 10",
    ),
    "no damping of the base": (("base_controller.damping=0",), criteria.RUNS, "3 9 10"),
    "E_m(0) = 1 J": (
        ("manipulator_controller.manipulator_initial_energy=1",),
        criteria.RUNS,
        "7 8",
    ),
    "E_b(0) = 10 J": (
        ("manipulator_controller.base_initial_energy=10",),
        criteria.RUNS,
        "7 9 10",
    ),
}


PAGE = Path(__file__).parents[2] / "docs" / "paper_statements.md"


def others() -> list[str]:
    return list(statements.SETS)[1:]


@cache
def measured(run: str, changes: Sequence[str] = (), prefix: str = "paper") -> Measures:
    name = f"{prefix}_{run}"
    if prefix == "paper" and run == "continuous":  # without the slow integration by DOP853
        with TemporaryDirectory() as folder:
            path = Path(folder) / "continuous.toml"
            path.write_text('extends = "paper_continuous"\nwithout = ["continuous_loop"]\n')
            return criteria.measure(experiment.run(scenario.load(str(path), changes)))
    return criteria.measure(experiment.run(scenario.load(name, changes)))


def failing(judged: dict[str, list[Criterion]]) -> list[str]:
    return [f.split()[1] for f, parts in judged.items() if not all(part.holds for part in parts)]


def changed(name: str) -> dict[str, list[Criterion]]:
    settings, runs, _ = CHANGES[name]
    return criteria.by_figure(
        {run: measured(run, settings if run in runs else ()) for run in criteria.RUNS}
    )


def test_every_statement_holds_with_the_papers_observer_and_bookkeeping() -> None:
    judged = criteria.by_figure({run: measured(run) for run in criteria.RUNS})
    assert failing(judged) == []
    assert list(judged) == list(statements.SIMULATION)


@pytest.mark.slow
@pytest.mark.parametrize("prefix", others())
def test_every_statement_holds_with_a_sustained_motion(prefix: str) -> None:
    judged = criteria.by_figure({run: measured(run, (), prefix) for run in criteria.RUNS})
    assert failing(judged) == []


@pytest.mark.parametrize("name", family(CHANGES, 2))
def test_a_change_of_the_assumptions_fails_the_named_statements(name: str) -> None:
    assert failing(changed(name)) == CHANGES[name][2].split()


@pytest.mark.parametrize(
    ("drift", "figures"),
    [
        ("[1e-4, 0, 0, 0, 0, 0]", []),
        ("[3e-4, 0, 0, 0, 0, 0]", ["7"]),
        ("[0, 0, 0, 0, 1e-4, 0]", ["4"]),
    ],
)
def test_a_start_drift_or_spin_can_fail_a_statement(drift: str, figures: list[str]) -> None:
    settings = (f"free_flyer.base_velocity={drift}",)
    runs = {run: measured(run, settings) for run in criteria.RUNS}
    assert failing(criteria.by_figure(runs)) == figures


def test_without_a_start_offset_four_statements_fail() -> None:
    settings = ("reference_trajectory.start_offset=[0, 0, 0, 0, 0, 0]",)
    runs = {run: measured(run, settings) for run in criteria.RUNS}
    assert failing(criteria.by_figure(runs)) == ["3", "4", "9", "10"]


# Start postures [rad], and the figures whose statement then fails.
POSTURES = {
    (-0.78, 0.09939, -1.51474, -0.65984, -1.69574, 0.89924): ["4", "7", "8", "9"],
    (-0.90212, -0.21099, -1.2234, 0.17064, -1.51005, 0.02392): ["7", "8"],
    (0.66515, 0.14122, -1.19603, -0.41369, -1.35487, -0.03439): ["7", "8"],
    (0.36406, -0.15014, -1.2628, -0.39599, -1.79222, -0.62839): ["7"],
}


@pytest.mark.slow
@pytest.mark.parametrize("posture", POSTURES)
def test_with_another_start_posture_not_all_statements_hold(posture: tuple[float, ...]) -> None:
    pose = end_effector_pose(
        constant_mechanism(load_robot_file()),
        ca.SX(3, 1),
        ca.SX([0, 0, 0, 1]),
        ca.SX(ca.DM(list(posture))),
    )
    position, orientation = (np.array(ca.evalf(part)).ravel().tolist() for part in pose)
    settings = (
        f"free_flyer.joint_position={list(posture)}",
        f"reference_trajectory.initial_position={position}",
        f"reference_trajectory.initial_orientation={orientation}",
    )
    runs = {run: measured(run, settings) for run in criteria.RUNS}
    assert failing(criteria.by_figure(runs)) == POSTURES[posture]


@pytest.mark.parametrize(
    "prefix", ["paper", *(pytest.param(name, marks=pytest.mark.slow) for name in others())]
)
def test_the_page_has_the_criteria_and_values_of_each_figure(prefix: str) -> None:
    judged = criteria.by_figure({run: measured(run, (), prefix) for run in criteria.RUNS})
    for figure, parts in judged.items():
        assert f"| {figure} | {'; '.join(map(str, parts))} |" in PAGE.read_text()


@pytest.mark.slow
def test_every_criterion_fails_for_one_of_the_changes() -> None:
    failed = {
        (figure, part.what)
        for name in CHANGES
        for figure, parts in changed(name).items()
        for part in parts
        if not part.holds
    }
    judged = changed("half the amplitude")
    assert failed == {(figure, part.what) for figure, parts in judged.items() for part in parts}


@pytest.mark.slow
def test_at_1_khz_the_sustained_set_diverges_by_the_sampled_spring_of_the_end_effector() -> None:
    """K_Pm T_m / 2 = 2 N s/m is above K_Dm = 1.2 N s/m. The statement on Fig. 3 needs 0.1 ms."""
    settings = ["base_controller.period=0.001"]
    result = experiment.run(scenario.load("sustained_unstable", settings))
    assert result.outcome.diverged
    assert 30.0 < result.outcome.simulated < 45.0


@given(
    st.floats(-10, 10),
    st.sampled_from([-2e-5, 0.0, 0.3, 4.0]),
    st.booleans(),
)
def test_a_margin_is_above_1_exactly_if_a_criterion_with_a_nonzero_bound_holds(
    value: float, bound: float, is_low: bool
) -> None:
    part = Criterion(what="x", value=value, **{"low" if is_low else "high": bound})
    assert part.holds == (value > bound if is_low else value < bound)
    if bound == 0.0:
        assert part.margin is None
    else:
        assert part.margin is not None
        assert (part.margin > 1.0) == part.holds or value == bound


def test_a_value_that_is_not_a_number_fails() -> None:
    assert not Criterion(what="x", value=float("nan"), low=-1.0).holds
    assert not Criterion(what="x", value=criteria.quotient(0.0, 0.0), high=0.1).holds
    assert criteria.quotient(1.0, 0.0) == float("inf")


def test_the_table_of_the_report_states_each_criterion_with_value_bound_and_margin() -> None:
    part = Criterion(what="base maximum", value=2e-4, unit="m", low=1e-4, high=9e-4)
    assert str(part) == "base maximum 0.0002 m (above 0.0001 and below 0.0009, margin 2)"
    failed = Criterion(what="base maximum", value=2e-3, unit="m", high=9e-4)
    assert str(failed).endswith("FAILS")
