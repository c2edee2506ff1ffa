"""Matched law: for a mass equal to its model it generates no energy, for all gains and periods."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer_fmus.equations.sampled_control import mean_wrench, sampled_damping

SX = ca.SX
_M, _K, _D, _T, _x, _v, _theta = (
    SX.sym(name, *shape)
    for name, shape in zip("MKDTxvh", [(6, 6)] * 3 + [()] + [(6,)] * 2 + [()], strict=True)
)
_wrench = mean_wrench(_M, _K, _D, _T, -_K @ _x, _v, _theta)
WRENCH = ca.Function("wrench", [_M, _K, _D, _T, _x, _v, _theta], [_wrench])
GAINS = ca.Function("gains", [_M, _K, _D, _T, _theta], [ca.jacobian(_wrench, w) for w in (_x, _v)])
seeds, periods = st.integers(0, 2**32 - 1), st.floats(1e-3, 1.0)


def positive(random: np.random.Generator, size: float) -> np.ndarray:
    """Return a full symmetric positive definite 6x6 matrix; eigenvalues over two decades."""
    Q = np.linalg.qr(random.normal(size=(6, 6)))[0]
    return np.asarray(Q @ np.diag(size * 10.0 ** random.uniform(-1, 1, 6)) @ Q.T)


def case(seed: int) -> tuple[np.random.Generator, np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return random, positive(random, 30.0), positive(random, 300.0), positive(random, 100.0)


def held_motion(
    M: np.ndarray, F: np.ndarray, T: float, x: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return position and velocity of a mass after T under a constant wrench, exactly."""
    a = np.linalg.solve(M, F)
    return x + T * v + 0.5 * T * T * a, v + T * a


@given(seeds, periods)
def test_the_work_of_the_held_wrench_is_that_of_a_spring_and_a_damper(seed: int, T: float) -> None:
    random, M, K, D = case(seed)
    x, v = random.normal(size=6), random.normal(size=6)
    F = np.array(WRENCH(M, K, D, T, x, v, 0.5)).ravel()
    after, _ = held_motion(M, F, T, x, v)
    mean_velocity = (after - x) / T
    stored = 0.5 * (after @ K @ after - x @ K @ x)
    dissipated = T * mean_velocity @ D @ mean_velocity
    scale = abs(F) @ abs(after - x) + abs(stored) + dissipated
    assert F @ (after - x) == pytest.approx(-stored - dissipated, abs=1e-10 * scale)


def transition(
    M_true: np.ndarray, M: np.ndarray, K: np.ndarray, D: np.ndarray, T: float, theta: float
) -> np.ndarray:
    """Return the matrix (12, 12) from (x, v) at a sample to (x, v) at the next sample."""
    K_d, D_d = (-np.array(part) for part in GAINS(M, K, D, T, theta))
    columns = [
        np.concatenate(
            held_motion(M_true, -K_d @ state[:6] - D_d @ state[6:], T, state[:6], state[6:])
        )
        for state in np.eye(12)
    ]
    return np.array(columns).T


def spectral_radius(
    M_true: np.ndarray, M: np.ndarray, K: np.ndarray, D: np.ndarray, T: float
) -> float:
    return float(abs(np.linalg.eigvals(transition(M_true, M, K, D, T, 0.5))).max())


@given(seeds, periods)
def test_the_matched_law_is_stable_for_every_gain_and_period(seed: int, T: float) -> None:
    _, M, K, D = case(seed)
    assert spectral_radius(M, M, K, D, T) < 1.0


@given(
    st.floats(1.0, 200.0), st.floats(0.1, 1e4), st.floats(0.1, 1e4), periods, st.floats(1.0, 100.0)
)
def test_along_one_axis_it_is_stable_for_every_mass_above_its_model(
    m: float, k: float, d: float, T: float, factor: float
) -> None:
    assert (
        spectral_radius(factor * m * np.eye(6), *(value * np.eye(6) for value in (m, k, d)), T)
        < 1.0
    )


def test_for_a_mass_far_below_its_model_it_can_be_unstable() -> None:
    _, M, K, D = case(1)
    assert spectral_radius(0.2 * M, M, K, D, 1.0) > 1.0


def growth_of_V(M: np.ndarray, K: np.ndarray, D: np.ndarray, T: float, theta: float) -> float:
    """Return the largest V(1) / V(0) over all starts. V = v^T M v / 2 + x^T K x / 2."""
    root = np.linalg.cholesky(np.block([[K, np.zeros((6, 6))], [np.zeros((6, 6)), M]])).T
    step = root @ transition(M, M, K, D, T, theta) @ np.linalg.inv(root)
    return float(np.linalg.norm(step, 2) ** 2)


@given(seeds, periods, st.floats(0.5, 1.0))
def test_every_theta_from_one_half_on_is_stable_for_a_constant_inertia(
    seed: int, T: float, theta: float
) -> None:
    _, M, K, D = case(seed)
    assert abs(np.linalg.eigvals(transition(M, M, K, D, T, theta))).max() < 1.0


@given(seeds, periods)
def test_V_never_increases_with_theta_one_half_and_a_constant_inertia(seed: int, T: float) -> None:
    _, M, K, D = case(seed)
    assert growth_of_V(M, K, D, T, 0.5) < 1.0 + 1e-9


def test_with_a_larger_theta_V_can_increase_for_a_while() -> None:
    """Only theta = 1/2 makes the work of the held wrench that of a spring and a damper."""
    _, M, K, D = case(3)
    assert growth_of_V(M, K, D, 1.0, 0.6) > 2.0


@given(seeds)
def test_the_matched_law_tends_to_the_continuous_law(seed: int) -> None:
    _, M, K, D = case(seed)
    errors = []
    for T in (1e-4, 1e-5):
        K_d, D_d = (-np.array(part) for part in GAINS(M, K, D, T, 0.5))
        errors.append(
            max(np.abs(K_d - K).max() / np.abs(K).max(), np.abs(D_d - D).max() / np.abs(D).max())
        )
    assert errors[1] < 0.11 * errors[0]


@given(
    st.floats(1.0, 200.0), st.floats(0.0, 1e4), st.floats(0.0, 1e4), periods, st.floats(0.5, 1.0)
)
def test_its_damping_is_below_the_limit_of_a_held_damper(
    m: float, k: float, d: float, T: float, theta: float
) -> None:
    damping = float(ca.evalf(sampled_damping(SX(m), SX(k), SX(d), SX(T), theta)))
    _, D_d = (
        -np.array(part) for part in GAINS(m * np.eye(6), k * np.eye(6), d * np.eye(6), T, theta)
    )
    assert damping == pytest.approx(D_d[0, 0], rel=1e-12, abs=1e-12)
    assert damping < m / (theta * T) <= 2.0 * m / T
