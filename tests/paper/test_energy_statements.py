"""Statements of the documents on energy and passivity, each checked with a simulated run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from freeflyer.cli import main as command
from freeflyer.master.record import Record
from freeflyer.paper import criteria
from freeflyer.scenario import experiment, scenario

DATA = Path(__file__).parents[1] / "data"
CONTROLLER = "manipulator_controller"


def run(name: str, *settings: str) -> Record:
    return experiment.run(scenario.load(name, settings)).outcome.record


def observed(record: Record, port: str) -> np.ndarray:
    """Return the observed energy (rows,) [J], summed over the degrees of freedom, minus E(0)."""
    energy = record[f"{CONTROLLER}.{port}_observed_energy"]
    return np.asarray((energy - energy[0]).sum(axis=1))


@pytest.mark.parametrize("name", ["multirate_passive", "multirate_unstable"])
def test_at_the_true_ports_both_energies_have_the_sum_of_the_lost_kinetic_energy(name: str) -> None:
    """E_m + E_b = KE(0) - KE(t), up to the quadrature at the ports: some 1e-5 J."""
    record = run(name, "record.every_s=0.001", "stop_s=24")
    kinetic = record["free_flyer.kinetic_energy"]
    total = observed(record, "manipulator") + observed(record, "base")
    assert np.ptp(kinetic) > 0.02
    assert np.abs(total - (kinetic[0] - kinetic)).max() < 4e-5


def test_from_rest_with_no_initial_energy_both_energies_cannot_stay_positive() -> None:
    record = run(
        "multirate_passive", f"{CONTROLLER}.manipulator_initial_energy=0", "record.every_s=0.001",
        "stop_s=10",
    )  # fmt: skip
    smaller = np.minimum(observed(record, "manipulator"), observed(record, "base"))
    assert smaller.min() < -1e-4


@pytest.mark.parametrize("offset", ["[0, 0, 0, 0, 0, 0]", "[1e-4, 3e-4, -2e-4, 0, 0, 0]"])
def test_a_start_offset_is_no_energy_that_the_controllers_absorb(offset: str) -> None:
    """Its 2e-5 J are in the springs. At the true ports, nothing of it is absorbed."""
    record = run(
        "paper_passive",
        f"{CONTROLLER}.observer=port",
        f"{CONTROLLER}.bookkeeping=applied",
        f"reference_trajectory.start_offset={offset}",
    )
    total = observed(record, "manipulator")[-1] + observed(record, "base")[-1]
    assert abs(total) < 1e-6


def test_a_start_drift_is_energy_that_the_controllers_absorb() -> None:
    drift = "free_flyer.base_velocity=[1e-3, 0, 0, 0, 0, 0]"
    record = run(
        "paper_passive", f"{CONTROLLER}.observer=port", f"{CONTROLLER}.bookkeeping=applied", drift
    )
    kinetic = record["free_flyer.kinetic_energy"]
    total = observed(record, "manipulator")[-1] + observed(record, "base")[-1]
    assert kinetic[0] > 5e-5
    assert total == pytest.approx(kinetic[0] - kinetic[-1], abs=2e-6)


def test_with_sampling_energy_at_port_m_a_credit_of_1e_7_j_is_spent() -> None:
    slopes = []
    for credit in (0.0, 1e-7):
        result = experiment.run(
            scenario.load(
                "sustained_passive", [f"{CONTROLLER}.manipulator_initial_energy={credit}"]
            )
        )
        slopes.append(criteria.measure(result)["manipulator_energy_slope"])
    assert slopes[0] > 0.0 > slopes[1]


def held_spring(bookkeeping: str, damping: float) -> Record:
    """Run the sustained motion with a stiff sampled spring at the end-effector, without PC."""
    return run(
        "sustained_unstable",
        f"{CONTROLLER}.bookkeeping={bookkeeping}",
        f"{CONTROLLER}.damping=[{damping}, {damping}, {damping}, 0.04, 0.04, 0.04]",
        "base_controller.period=0.001",
        "record.every_s=0.001",
        "stop_s=12",
    )


def test_the_printed_bookkeeping_does_not_see_the_sampling_energy_of_port_m() -> None:
    """K_Pm T_m / 2 = 2 N s/m > K_Dm: port M generates energy, and (20) as printed absorbs some."""
    applied, printed = (
        observed(held_spring(bookkeeping, 0.2), "manipulator")
        for bookkeeping in ("applied", "as_printed")
    )
    assert applied.min() < 0.0
    assert printed[-1] - applied[-1] > 0.5 * -applied.min()


def test_the_printed_bookkeeping_does_not_see_a_sampled_damper_of_port_m() -> None:
    """K_Dm T_m > 2 m at the wrist: port M generates energy, and (20) as printed absorbs some."""
    applied, printed = (
        observed(
            run(
                "multirate_unstable",
                f"{CONTROLLER}.bookkeeping={bookkeeping}",
                f"{CONTROLLER}.damping=[80, 80, 80, 9, 9, 9]",
                "base_controller.period=0.001",
                "record.every_s=0.001",
            ),
            "manipulator",
        )
        for bookkeeping in ("applied", "as_printed")
    )
    assert applied.min() < -0.1
    assert printed.min() > -0.01


@pytest.mark.parametrize(
    ("inertia", "bound", "completes"),
    [
        ("diagonal", 0.5, False),
        ("diagonal", 0.15, True),
        ("coupled", 0.5, True),
        ("coupled", 1.9, True),
    ],
)
@pytest.mark.parametrize("observer", ["port", "paper"])
def test_the_default_bound_of_the_damper_at_port_m_is_too_large(
    observer: str, inertia: str, bound: float, completes: bool
) -> None:
    """With E_m(0) = 0 it acts at its bound. A single axis of the wrist moves less inertia."""
    settings = [
        f"{CONTROLLER}.manipulator_initial_energy=0",
        f"{CONTROLLER}.observer={observer}",
        f"{CONTROLLER}.damper_inertia={inertia}",
        f"{CONTROLLER}.damper_bound={bound}",
    ]
    result = experiment.run(scenario.load("multirate_passive", settings))
    assert result.outcome.diverged != completes


def test_a_run_and_an_audit_note_what_the_printed_bookkeeping_cannot_see(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    printed = f"{CONTROLLER}.bookkeeping=as_printed"
    out = str(tmp_path / "run")
    options = ["--set", "stop_s=1", "--out", out]
    assert command.call(["run", "sustained_passive", *options, "--set", printed]) == 0
    expected = "K_Pm T_m / 2 = 2 is above K_Dm = 1.2 in element 1"
    assert expected in capsys.readouterr().out
    assert command.call(["audit", out]) == 0
    assert expected in capsys.readouterr().out
    for scenario_and_settings in (["sustained_passive"], ["multirate_passive", "--set", printed]):
        assert command.call(["run", *scenario_and_settings, *options]) == 0
        assert "does not see" not in capsys.readouterr().out


def test_the_matched_law_diverges_if_the_base_command_acts_one_period_late(tmp_path: Path) -> None:
    path = tmp_path / "late.toml"
    path.write_text(
        f"""
extends = "multirate_matched"
expect = "diverges"
connections = [
  "base_controller.base_wrench -> late_wrench.commanded",
  "late_wrench.wrench -> free_flyer.base_wrench",
]
[components.late_wrench]
kind = "twin"
block = "{DATA / "late_wrench.py"}"
step_s = "=period"
"""
    )
    for theta, time in ((0.5, 18.0), (0.75, 18.5)):
        result = experiment.run(scenario.load(str(path), [f"base_controller.theta={theta}"]))
        assert result.outcome.diverged
        assert result.outcome.simulated == pytest.approx(time, abs=0.1)


@pytest.mark.slow
def test_tracking_does_not_recover_from_a_push_but_keeps_a_residual_motion(tmp_path: Path) -> None:
    """2 N m on joint 2 for 0.1 s: `port` diverges, `tracking` keeps 4 mm and 1.1 deg."""
    path = tmp_path / "push.toml"
    path.write_text(
        f"""
extends = "multirate_passive"
stop_s = 200
connections = [
  "manipulator_controller.joint_torque -> push.commanded",
  "push.torque -> free_flyer.joint_torque",
]
[components.push]
kind = "twin"
block = "{DATA / "push.py"}"
step_s = 0.001
"""
    )
    diverged = experiment.run(scenario.load(str(path)))
    assert diverged.outcome.diverged
    assert diverged.outcome.simulated == pytest.approx(18.8, abs=0.2)
    kept = experiment.run(
        scenario.load(
            str(path),
            [f"{CONTROLLER}.observer=tracking", f"{CONTROLLER}.manipulator_initial_energy=0"],
        )
    )
    matched = [f"{name}_controller.discretisation=matched" for name in ("manipulator", "base")]
    settings = [*matched, f"{CONTROLLER}.manipulator_passivity_control=false"]
    stable = experiment.run(
        scenario.load(str(path), [*settings, f"{CONTROLLER}.base_passivity_control=false"])
    )
    assert stable.summary["base_position_error_m"]["last_10_s"] < 1e-3
    assert stable.summary["base_orientation_error_deg"]["last_10_s"] < 0.2
    assert not kept.outcome.diverged
    assert kept.summary["base_position_error_m"]["last_10_s"] == pytest.approx(4.4e-3, rel=0.1)
    assert kept.summary["base_orientation_error_deg"]["last_10_s"] == pytest.approx(1.15, rel=0.1)
