"""Stability conditions of a held axis, compared with the eigenvalues of its exact map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.linalg import expm

from freeflyer.analysis.prediction.held_axis import sampled_damper, sampled_spring

positive = st.floats(1e-2, 1e3)


def radius(m: float, k: float, d: float, period: float, late: bool = False) -> float:
    """Return the spectral radius of the map over a period: of [x, v], or if late [x, v, force]."""
    held = expm(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0 / m], [0.0, 0.0, 0.0]]) * period)
    gain = np.array([[-k, -d]])
    if not late:
        return float(np.abs(np.linalg.eigvals(held[:2, :2] + held[:2, 2:] @ gain)).max())
    with_force = np.block([[held[:2, :2], held[:2, 2:]], [gain, np.zeros((1, 1))]])
    return float(np.abs(np.linalg.eigvals(with_force)).max())


@given(m=positive, k=positive, d=positive, period=st.floats(1e-3, 10.0))
def test_an_axis_is_stable_if_and_only_if_both_conditions_hold(
    m: float, k: float, d: float, period: float
) -> None:
    spring, damper = (
        float(sampled_spring(np.array(k), np.array(d), period)),
        float(sampled_damper(np.array(d), np.array(m), period)),
    )
    # Near the boundary the rounding of the eigenvalues is larger than the margin.
    exact = radius(m, k, d, period)
    assume(abs(exact - 1.0) > 1e-7)
    assert (exact < 1.0) == (spring < 1.0 and damper < 1.0)


@given(m=positive, k=positive, d=positive)
def test_a_delay_of_one_period_divides_the_stable_period_of_a_spring_by_three(
    m: float, k: float, d: float
) -> None:
    """To first order in the period, so far from the damper's condition; checked to 1 %."""
    boundary = 2.0 * d / (3.0 * k)
    assume(float(sampled_damper(np.array(d), np.array(m), boundary, late=True)) < 1e-3)
    assert sampled_spring(np.array(k), np.array(d), boundary, late=True) == pytest.approx(1.0)
    assert (
        radius(m, k, d, 0.99 * boundary, late=True)
        < 1.0
        < radius(m, k, d, 1.01 * boundary, late=True)
    )


@given(m=positive, d=positive)
def test_a_delay_of_one_period_halves_the_stable_period_of_a_damper(m: float, d: float) -> None:
    boundary = m / d
    assert sampled_damper(np.array(d), np.array(m), boundary, late=True) == pytest.approx(1.0)
    # Without a spring the position is neutral. The condition applies to velocity and force.
    for factor, stable in ((0.99, True), (1.01, False)):
        a = factor * boundary * d / m
        assert (np.abs(np.roots([1.0, -1.0, a])).max() < 1.0) == stable


def test_a_spring_without_damping_is_unstable_at_every_period() -> None:
    assert sampled_spring(np.array([150.0]), np.array([0.0]), 1e-6) == np.inf
