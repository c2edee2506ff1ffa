"""The two conditions of a held axis against the eigenvalues of its exact map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.linalg import expm

from freeflyer.analysis.prediction.held_axis import sampled_damper, sampled_spring

positive = st.floats(1e-2, 1e3)


def radius(m: float, k: float, d: float, period: float, late: bool = False) -> float:
    """Of the map over a period, by SciPy's matrix exponential and NumPy's eigenvalues; of [x, v] or [x, v, answer]."""
    held = expm(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0 / m], [0.0, 0.0, 0.0]]) * period)
    answer = np.array([[-k, -d]])
    if not late:
        return float(np.abs(np.linalg.eigvals(held[:2, :2] + held[:2, 2:] @ answer)).max())
    with_answer = np.block([[held[:2, :2], held[:2, 2:]], [answer, np.zeros((1, 1))]])
    return float(np.abs(np.linalg.eigvals(with_answer)).max())


@given(m=positive, k=positive, d=positive, period=st.floats(1e-3, 10.0))
def test_an_axis_is_stable_exactly_if_both_conditions_hold(
    m: float, k: float, d: float, period: float
) -> None:
    spring, damper = (
        float(sampled_spring(np.array(k), np.array(d), period)),
        float(sampled_damper(np.array(d), np.array(m), period)),
    )
    # Eigenvalues of a map cannot tell a boundary that is nearer than rounding.
    exact = radius(m, k, d, period)
    assume(abs(exact - 1.0) > 1e-7)
    assert (exact < 1.0) == (spring < 1.0 and damper < 1.0)


@given(m=positive, k=positive, d=positive)
def test_an_answer_that_is_a_whole_period_late_takes_two_thirds_of_the_springs_period(
    m: float, k: float, d: float
) -> None:
    """To first order in the period: where the damper's own condition is far away, at 1 % on either side."""
    boundary = 2.0 * d / (3.0 * k)
    assume(float(sampled_damper(np.array(d), np.array(m), boundary, late=True)) < 1e-3)
    assert sampled_spring(np.array(k), np.array(d), boundary, late=True) == pytest.approx(1.0)
    assert (
        radius(m, k, d, 0.99 * boundary, late=True)
        < 1.0
        < radius(m, k, d, 1.01 * boundary, late=True)
    )


@given(m=positive, d=positive)
def test_a_damper_that_is_a_whole_period_late_takes_half_of_its_period(m: float, d: float) -> None:
    boundary = m / d
    assert sampled_damper(np.array(d), np.array(m), boundary, late=True) == pytest.approx(1.0)
    # Without a spring the position itself is neutral: velocity and answer are what the condition is about.
    for factor, stable in ((0.99, True), (1.01, False)):
        a = factor * boundary * d / m
        assert (np.abs(np.roots([1.0, -1.0, a])).max() < 1.0) == stable


def test_a_spring_without_damping_is_unstable_at_every_period() -> None:
    assert sampled_spring(np.array([150.0]), np.array([0.0]), 1e-6) == np.inf
