"""Observers with a reference energy, preview, filter and prediction of the robust loop."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import pytest
from commands import run_command
from hypothesis import given
from hypothesis import strategies as st

from freeflyer.scenario import experiment, scenario
from freeflyer.scenario.experiment import Result
from freeflyer_fmus.equations import passivity
from freeflyer_fmus.equations.sampled_control import mean_step

SX = ca.SX
MATCHED = [f"{name}_controller.discretisation=matched" for name in ("manipulator", "base")]


def value(expression: SX) -> np.ndarray:
    return np.array(ca.evalf(SX(expression))).ravel()


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10.0))
def test_a_common_damper_dissipates_the_missing_energy_in_one_period(seed: int, w: float) -> None:
    random = np.random.default_rng(seed)
    E, v = random.normal(size=6) - 1.0, random.normal(size=6)
    beta = value(passivity.common_damper(SX(ca.DM(E)), SX(ca.DM(v)), SX(w), SX(0.3), SX(1e-8)))[0]
    if E.sum() >= 0.0:
        assert beta == 0.0
    else:
        weighted = v * np.array([1, 1, 1, w, w, w])
        assert beta * weighted @ weighted * 0.3 == pytest.approx(-E.sum(), rel=1e-9)


def test_a_continuous_spring_damper_absorbs_its_reference_energy() -> None:
    """Sampled finely, the energy beyond the reference vanishes with the period."""
    names = ("E", "F_before", "v_before", "v", "T", "U", "U_before", "begun")
    E, F_before, v_before, v, T, U, U_before, begun = (SX.sym(name) for name in names)
    absorbed = passivity.observed_as_applied(E, F_before, v_before, v, T)
    beyond = absorbed - begun * passivity.reference_energy(U, U_before, 5.0, v, T)
    step = ca.Function("step", [E, F_before, v_before, v, T, U, U_before, begun], [beyond])
    missing = []
    for period in (1e-3, 1e-4):
        x, speed, energy, force, speed_before, spring_before = 0.1, 0.3, 0.0, 0.0, 0.3, 0.0
        for k in range(int(2.0 / period)):
            spring = 50.0 * x * x
            energy = float(
                step(energy, force, speed_before, speed, period, spring, spring_before, k > 0)
            )
            force, speed_before, spring_before = -100.0 * x - 5.0 * speed, speed, spring
            x, speed = x + period * speed + 0.5 * period**2 * force, speed + period * force
        missing.append(abs(energy))
    assert missing[0] < 0.05
    assert missing[1] < 0.2 * missing[0]


@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1.0))
def test_a_step_of_the_mean_law_is_the_exact_motion_under_its_wrench(seed: int, T: float) -> None:
    random = np.random.default_rng(seed)
    m, k, d, x, v = (*random.uniform(0.1, 10.0, 3), *random.normal(size=2))
    moved, faster = (
        value(part)[0]
        for part in mean_step(*(SX(float(number)) for number in (m, k, d, T, -k * x, v)))
    )
    mean = (m * v - 0.5 * T * k * x) / (m + 0.5 * T * d + 0.25 * T * T * k)
    F = -k * (x + 0.5 * T * mean) - d * mean
    assert moved == pytest.approx(T * v + 0.5 * T * T * F / m, rel=1e-9, abs=1e-12)
    assert faster == pytest.approx(T * F / m, rel=1e-9, abs=1e-12)


def run(name: str, *settings: str) -> Result:
    return experiment.run(scenario.load(name, settings))


def late(result: Result, key: str = "base_position_error_m") -> float:
    return float(result.summary[key]["last_10_s"])


def test_the_preview_in_the_middle_of_the_period_makes_the_base_error_ten_times_smaller() -> None:
    plain, with_preview, early = (
        late(
            run(
                "robust",
                *MATCHED,
                f"base_controller.preview={preview}",
                f"reference_trajectory.preview_share={share}",
            )
        )
        for preview, share in (("false", 0.5), ("true", 0.5), ("true", 0.4))
    )
    assert with_preview < 0.15 * plain
    assert early > 1.5 * with_preview


def test_the_filter_makes_the_loop_insensitive_to_noise() -> None:
    noise = [
        "measurement_noise.position_noise=3e-4",
        "measurement_noise.orientation_noise=3e-4",
        "measurement_noise.velocity_noise=3e-3",
        "measurement_noise.angular_velocity_noise=3e-3",
        "measurement_noise.joint_position_noise=3e-5",
        "measurement_noise.joint_velocity_noise=3e-4",
        "stop_s=60",
    ]
    without = run("disturbed", *noise, "base_controller.filtered=false")
    for without_lag in ("false", "true"):
        with_filter = run(
            "disturbed", *noise, f"manipulator_controller.filter_without_lag={without_lag}"
        )
        assert late(with_filter) < 2e-3
        assert late(without) > 3.0 * late(with_filter)


PUSH = "disturbance.pulse_joint_torque=[0, 0, 5, 0, 0, 0]"


@pytest.mark.parametrize("is_late", [False, True])
def test_the_filter_without_lag_keeps_the_damping_of_the_base(is_late: bool) -> None:
    """The lagging filter takes K_P tau = 1.2 of the 2 N m s/rad away. The PC is off."""
    delay = ["base_command_delay.delay==base_controller.period"] if is_late else []
    lagging, without_lag, unfiltered = (
        late(
            run(
                "disturbed",
                PUSH,
                *delay,
                "manipulator_controller.base_passivity_control=false",
                "stop_s=80",
                setting,
            ),
            "base_orientation_error_deg",
        )
        for setting in (
            "manipulator_controller.filter_without_lag=false",
            "manipulator_controller.filter_without_lag=true",
            "base_controller.filtered=false",
        )
    )
    assert without_lag < 0.4 * lagging
    assert without_lag < 3.0 * unfiltered


def test_joint_friction_does_not_use_up_the_energy_of_the_facility_with_the_reference_energy() -> (
    None
):
    """Coulomb friction of 0.3 N m uses up E_m(0) of `facility`: its PC then brakes the motion."""
    port, reference = (
        run(name, "arm_drive.coulomb_friction=0.3").summary["end_effector_position_error_m"]["max"]
        for name in ("facility", "facility_robust")
    )
    assert reference < 4e-3
    assert port > 5e-2


def test_in_parallel_exchange_the_first_sample_of_the_base_uses_the_measured_errors() -> None:
    """In parallel exchange, this sample reads the filtered errors as they are initialised."""
    off = ["free_flyer.base_position=[0.02, -0.01, 0]", "stop_s=0.1"]
    sequential, parallel = (
        run("robust", *off, f"exchange={exchange}").outcome.record["base_controller.base_wrench"]
        for exchange in ("sequential", "parallel")
    )
    assert np.linalg.norm(sequential[0]) > 1.0
    assert np.abs(parallel[0] - sequential[0]).max() < 1e-12


@pytest.mark.parametrize("period", [0.15, 0.3, pytest.param(1.0, marks=pytest.mark.slow)])
def test_the_prediction_makes_a_late_base_command_convergent(period: float) -> None:
    settings = [
        "base_command_delay.delay==base_controller.period",
        f"base_controller.period={period}",
    ]
    predicted = run("disturbed", *settings)
    assert not predicted.outcome.diverged
    assert late(predicted) < 1.5e-3
    assert late(predicted, "base_orientation_error_deg") < 0.5
    if period < 1.0:
        assert run("disturbed", *settings, "base_controller.command_delay=0").outcome.diverged


def test_the_loop_recovers_from_a_push_that_makes_the_default_loop_diverge() -> None:
    push = ["disturbance.pulse_joint_torque=[0, 2, 0, 0, 0, 0]", "stop_s=200"]
    result = run("disturbed", *push)
    assert not result.outcome.diverged
    assert late(result) < 5e-4
    assert late(result, "base_orientation_error_deg") < 0.05


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["base_controller.command_delay=0.00025"], "choose a multiple of manipulator_period"),
        (["base_controller.command_delay=0.4"], "choose a command_delay of at most one period"),
        (
            ["manipulator_controller.filter_time=0.5"],
            "choose a filter that is faster than the period",
        ),
        (["manipulator_controller.filter_time=0"], "set its filter_time, or switch off filtered"),
        (["reference_trajectory.preview_period=0"], "connect the preview outputs of the reference"),
        (["manipulator_controller.bookkeeping=as_printed"], "needs the bookkeeping `applied`"),
        (["manipulator_controller.angular_velocity_weight=0"], "angular_velocity_weight is 0"),
    ],
)
def test_contradictory_settings_are_rejected_with_one_sentence(
    capsys: pytest.CaptureFixture[str], tmp_path: object, settings: Sequence[str], message: str
) -> None:
    given_settings = [part for s in settings for part in ("--set", s)]
    arguments = ["run", "robust", *given_settings, "--set", "stop_s=1", "--out", f"{tmp_path}/out"]
    code, error = run_command(capsys, *arguments)
    assert code == 2
    assert message in error


def test_inputs_that_are_not_connected_are_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: object
) -> None:
    for key in ("preview", "filtered"):
        arguments = ["--set", f"base_controller.{key}=true", "--out", f"{tmp_path}/out"]
        code, error = run_command(capsys, "run", "multirate_matched", *arguments)
        assert code == 2
        assert "connect the " in error
