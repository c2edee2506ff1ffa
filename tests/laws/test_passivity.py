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
from freeflyer_fmus.equations.passivity import DamperInertia
from freeflyer_fmus.equations.sampled_control import mean_wrench

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


def random_inertia(seed: int) -> np.ndarray:
    """Return a random inertia (6, 6) with coupled axes, each axis with a unit of its own."""
    random = np.random.default_rng(seed)
    factor = random.normal(size=(6, 6)) * 10.0 ** random.uniform(-1.0, 0.0, 6)
    units = 10.0 ** random.uniform(-1.0, 1.0, 6)
    return np.asarray(units[:, None] * (factor @ factor.T + 1e-3 * np.eye(6)) * units)


def coupled(inertia: np.ndarray) -> np.ndarray:
    return np.array(ca.evalf(passivity.coupled_inertia(SX(ca.DM(inertia))))).ravel()


seeds = st.integers(0, 2**32 - 1)


@given(seeds)
def test_the_coupled_inertia_is_below_the_inertia_matrix(seed: int) -> None:
    M = random_inertia(seed)
    m, alone = coupled(M), 1.0 / np.diag(np.linalg.inv(M))
    assert (m > 0.0).all()
    assert (m <= alone * (1 + 1e-9)).all()
    # The eigenvalues of M^-1 diag(m) are at most 1. They do not depend on units.
    assert np.linalg.eigvals(np.linalg.solve(M, np.diag(m))).real.max() <= 1 + 1e-9


@given(seeds)
def test_the_coupled_inertia_does_not_depend_on_units(seed: int) -> None:
    M, units = random_inertia(seed), 10.0 ** np.random.default_rng(seed).uniform(-2.0, 2.0, 6)
    changed = coupled(units[:, None] * M * units)
    assert changed == pytest.approx(units**2 * coupled(M), rel=1e-6)


def test_the_coupled_inertia_of_uncoupled_axes_is_their_inertia() -> None:
    diagonal = np.array([150.0, 150.0, 150.0, 38.0, 20.0, 23.0])
    assert coupled(np.diag(diagonal)) == pytest.approx(diagonal, rel=1e-12)


@pytest.mark.parametrize("is_matched", [False, True])
@given(seeds, st.floats(0.1, 1.99), st.floats(1e-3, 1.0))
def test_with_coupled_inertia_held_dampers_at_their_bound_and_the_law_dissipate_energy(
    is_matched: bool, seed: int, c: float, period: float
) -> None:
    """The body has constant inertia. The spring is at rest, so that the law is a damper."""
    random, M = np.random.default_rng(seed), random_inertia(seed)
    m = coupled(M)
    # The law alone uses a part of the bound, so that all dampers are active.
    share = random.uniform(0.0, 0.9, 2) * c * m[:, None] / period / [2.0, period]
    K_D, K_P = SX(ca.DM(share[:, 0])), SX(ca.DM(share[:, 1]))
    T, theta = SX(period), SX(0.5)
    number = SX(int(DamperInertia.coupled))
    bound = passivity.bound_of_axes(number, SX(int(is_matched)), SX(ca.DM(M)), K_P, K_D, T, theta)
    beta = np.array(ca.evalf(passivity.bounded(SX(1e9), SX(c), *bound, T))).ravel()
    assert (beta > 0.0).all()
    v = random.normal(size=6)
    if is_matched:
        held = mean_wrench(
            SX(ca.DM(M)), ca.diag(K_P), ca.diag(K_D), T, SX.zeros(6), SX(ca.DM(v)), theta
        )
    else:
        held = -K_D * SX(ca.DM(v))
    F = np.array(ca.evalf(held)).ravel() - beta * v
    later = v + period * np.linalg.solve(M, F)
    assert later @ M @ later <= v @ M @ v * (1 + 1e-9)


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
