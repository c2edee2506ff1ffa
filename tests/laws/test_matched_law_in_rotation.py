"""Where the premise of the matched law, a constant inertia, does not hold: one rotating body."""

from __future__ import annotations

import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import rigid_body

from freeflyer_fmus.equations.sampled_control import mean_wrench

SATELLITE = np.array([[38.0, 20.0, 23.0]])
"""Principal moments of the paper's satellite [kg m2]."""


def tilted(
    K: float, D: float, T: float, degrees: float, axis: tuple[float, ...]
) -> rigid_body.Bodies:
    """Return the satellite at rest, rotated by an angle about an axis that is not principal."""
    vector = np.radians(degrees) * np.array([axis]) / np.linalg.norm(axis)
    parts = [np.array([value]) for value in (K, D, T)]
    return rigid_body.Bodies(SATELLITE, *parts, rigid_body.exponential(vector), np.zeros((1, 3)))


def test_a_stiff_spring_and_a_long_period_generate_energy_on_a_rotating_body() -> None:
    """K = 4000, D = 20, T = 2 s, start 5 deg: 15 J become more than 1,000 times as much."""
    V = rigid_body.run(tilted(4000.0, 20.0, 2.0, 5.0, (1.0, 1.0, 1.0)), 0.5)[:, 0]
    assert V[0] == pytest.approx(15.2, abs=0.1)
    assert V.max() > 1000.0 * V[0]


def test_a_start_at_90_degrees_generates_energy_on_a_rotating_body() -> None:
    """K = 400, D = 4, T = 1 s: about 6 times the start energy."""
    V = rigid_body.run(tilted(400.0, 4.0, 1.0, 90.0, (0.3, -0.5, 0.8)), 0.5)[:, 0]
    assert 5.0 < V.max() / V[0] < 8.0


def test_about_a_principal_axis_the_inertia_is_constant_and_no_energy_appears() -> None:
    V = rigid_body.run(tilted(4000.0, 20.0, 2.0, 5.0, (1.0, 0.0, 0.0)), 0.5)[:, 0]
    assert V.max() <= V[0] * (1.0 + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("theta", [0.6, 0.75])
def test_with_a_larger_theta_all_of_200_random_bodies_end_below_their_start_energy(
    theta: float,
) -> None:
    V = rigid_body.run(rigid_body.drawn(200, 5), theta)
    assert (V[-1] < V[0]).all()


@pytest.mark.slow
def test_with_theta_one_half_some_of_200_random_bodies_end_above_their_start_energy() -> None:
    V = rigid_body.run(rigid_body.drawn(200, 5), 0.5)
    assert (V[-1] > V[0]).any()


def test_the_law_of_these_bodies_is_that_of_the_controllers() -> None:
    bodies = rigid_body.drawn(20, 3)
    for theta in (0.5, 0.7):
        torque = bodies.torque(theta)
        for k, inertia in enumerate(bodies.inertia_in_I()):
            quaternion = bodies.q[k] * (-1.0 if bodies.q[k, 3] < 0.0 else 1.0)
            gains = (ca.SX(ca.DM(value * np.eye(3))) for value in (bodies.k[k], bodies.d[k]))
            spring = ca.SX(ca.DM(-bodies.k[k] * 2.0 * quaternion[:3]))
            wrench = mean_wrench(
                ca.SX(ca.DM(inertia)), *gains, ca.SX(bodies.T[k]), spring, ca.SX(ca.DM(bodies.w[k])), theta
            )  # fmt: skip
            assert np.array(ca.evalf(wrench)).ravel() == pytest.approx(
                torque[k], rel=1e-9, abs=1e-9
            )
