"""Passivity: observed energy is absorbed energy; dampers dissipate deficits and stay finite."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer.scenario import experiment, scenario
from freeflyer_fmus.equations import passivity

SX = ca.SX
T = 1e-3


def value(expression: SX) -> float:
    return float(ca.evalf(SX(expression)))


def test_a_spring_damper_absorbs_energy_in_both_bookkeepings() -> None:
    """By the printed sign it would be active: F v, with F on the robot, is supplied energy."""
    x, v, E_printed, E_applied, F_before, v_before = 0.1, 0.0, 0.0, 0.0, 0.0, 0.0
    for _ in range(5000):
        F = -100.0 * x - 20.0 * v
        E_printed = value(
            passivity.observed_as_printed(SX(E_printed), SX(F), SX(v), SX(0), SX(0), SX(T))
        )
        E_applied = value(
            passivity.observed_as_applied(SX(E_applied), SX(F_before), SX(v_before), SX(v), SX(T))
        )
        F_before, v_before = F, v
        x, v = x + T * v + 0.5 * T * T * F, v + T * F
    # The spring's 0.5 J went into the mass and back: energy of the damper minus that of the spring.
    assert E_applied == pytest.approx(-0.5 * v * v, abs=1e-6)
    assert E_printed == pytest.approx(E_applied, abs=2e-3)


def test_the_applied_energy_of_a_held_force_is_force_times_displacement() -> None:
    F, v0, v1 = 3.0, 0.2, 0.5
    assert value(
        passivity.observed_as_applied(SX(1.0), SX(F), SX(v0), SX(v1), SX(0.1))
    ) == pytest.approx(1.0 - F * 0.1 * (v0 + v1) / 2)


@given(st.floats(-1.0, -1e-9), st.floats(1e-2, 2.0))
def test_a_damper_dissipates_the_deficit_in_one_period(E: float, v: float) -> None:
    beta = value(passivity.damper(SX(E), SX(v), SX(0.3), SX(1e-8)))
    assert beta * v * v * 0.3 == pytest.approx(-E, rel=1e-9)


@given(st.floats(-1e3, 1e3), st.floats(-1e-9, 1e-9))
def test_a_damper_is_finite_at_rest_and_never_supplies_energy(E: float, v: float) -> None:
    beta = value(passivity.damper(SX(E), SX(v), SX(1e-3), SX(1e-8)))
    assert 0.0 <= beta <= 1e12
    assert -beta * v * v <= 0.0
    assert E < 0 or beta == 0.0


@given(st.floats(0.0, 1e9), st.floats(1.0, 200.0), st.floats(0.0, 500.0), st.floats(1e-3, 1.0))
def test_a_bounded_damper_plus_the_laws_damping_is_below_the_limit_of_a_held_damper(
    beta: float, m: float, K_D: float, period: float
) -> None:
    bounded = value(passivity.bounded(SX(beta), SX(0.5), SX(m), SX(K_D), SX(period)))
    assert 0.0 <= bounded <= beta
    assert bounded == 0.0 or bounded + K_D <= 0.5 * m / period * (1 + 1e-12)


def test_the_energy_at_the_derived_ports_closes_to_the_stated_residual(tmp_path: Path) -> None:
    """(F_b, tau) is held; the powers of the derived F_B and F_m are less exact: 3e-6 J in 20 s."""
    path = tmp_path / "audit.toml"
    path.write_text('extends = "multirate_passive"\nstop_s = 20.0\n[record]\nevery_s = 0.001\n')
    record = experiment.run(scenario.load(str(path))).outcome.record
    lever = np.asarray(
        record["free_flyer.end_effector_position"] - record["free_flyer.base_position"]
    )
    F_m, F_b = (
        record["manipulator_controller.end_effector_wrench"],
        record["base_controller.base_wrench"],
    )
    at_base = F_m.copy()
    at_base[:, 3:] += np.cross(lever, F_m[:, :3])
    moved = {
        name: 0.5 * T * (record[f"free_flyer.{name}"][1:] + record[f"free_flyer.{name}"][:-1])
        for name in ("base_velocity", "end_effector_velocity")
    }
    port_b = np.sum((F_b - at_base)[:-1] * moved["base_velocity"], axis=1)
    port_m = np.sum(F_m[:-1] * moved["end_effector_velocity"], axis=1)
    kinetic = record["free_flyer.kinetic_energy"]
    residual = np.abs(np.cumsum(port_b + port_m) - (kinetic[1:] - kinetic[0])).max()
    print(
        f"\nresidual at ports B and M over 20 s: {residual:.1e} J of {np.abs(port_m).sum():.2g} J moved"
    )
    assert np.abs(port_m).sum() > 0.1
    assert residual < 1e-5
