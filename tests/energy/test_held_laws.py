"""Energy that held springs and dampers generate, in translation and rotation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from freeflyer.analysis.audit import energy

Array = NDArray[np.float64]
NANOSECONDS = 1_000_000_000


def on_x(values: Array) -> Array:
    """Return 6-vectors (n, 6) with `values` (n) as the x component."""
    six = np.zeros((len(values), 6))
    six[:, 0] = values
    return six


@given(
    K=st.floats(0.0, 500.0),
    D=st.floats(0.0, 100.0),
    m=st.floats(1.0, 200.0),
    milliseconds=st.integers(1, 300),
    rows_per_hold=st.integers(1, 5),
    x=st.floats(-1.0, 1.0),
    v=st.floats(-1.0, 1.0),
)
def test_the_virtual_energy_of_a_held_spring_damper_on_a_mass(
    K: float, D: float, m: float, milliseconds: int, rows_per_hold: int, x: float, v: float
) -> None:
    """Per hold, with the acceleration a: K/2 dx^2 by the spring, D (v a T^2/2 + a^2 T^3/3) by the
    damper. The latter is the integral of D (v(t) - v(0)) v(t).

    The kinetic energy of the mass changes by V less the stored and the dissipated energy.
    """
    period = milliseconds * 1_000_000 // rows_per_hold * rows_per_hold
    T, h = period / NANOSECONDS, period / rows_per_hold / NANOSECONDS
    xs, vs, expected = [x], [v], 0.0
    for _ in range(12):
        x, v = xs[-1], vs[-1]
        a = (-K * x - D * v) / m
        for row in range(1, rows_per_hold + 1):
            s = row * h
            xs.append(x + v * s + 0.5 * a * s * s)
            vs.append(v + a * s)
        expected += 0.5 * K * (v * T + 0.5 * a * T * T) ** 2 + D * (
            0.5 * v * a * T**2 + a * a * T**3 / 3.0
        )
    time = np.arange(len(xs)) * h
    position, velocity = on_x(np.array(xs)), on_x(np.array(vs))
    sampled = [energy.last_samples(time, values, period) for values in (position, velocity)]
    force = energy.held(-K * sampled[0] - D * sampled[1], share=1.0)
    worked = energy.work(force, np.diff(position, axis=0))
    stored = energy.spring_energy(np.full(6, K), position)
    dissipated = energy.dissipation(time, np.full(6, D), velocity)
    virtual = energy.virtual_energy(worked, stored, dissipated)[-1, 0]
    scale = np.abs(worked).max() + stored.max() + dissipated.max() + 1e-12
    assert virtual == pytest.approx(expected, abs=1e-9 * scale)
    gained = 0.5 * m * (vs[-1] ** 2 - vs[0] ** 2)
    assert virtual - (stored[-1] - stored[0])[0] - dissipated[-1, 0] == pytest.approx(
        gained, abs=1e-9 * (scale + 0.5 * m)
    )


def test_a_held_spring_generates_more_than_its_damper_dissipates_if_its_period_is_long() -> None:
    """The condition is K T/2 > D, which is K_P T_b/2 > K_D for the base."""
    time = np.linspace(0.0, 60.0, 60_001)
    slow = on_x(np.sin(0.5 * time))
    speed = on_x(0.5 * np.cos(0.5 * time))
    for D, generates in ((14.0, True), (16.0, False)):
        K, period = 150.0, 200_000_000
        force = energy.held(
            -K * energy.last_samples(time, slow, period)
            - D * energy.last_samples(time, speed, period),
            1.0,
        )
        gain = energy.work(force, np.diff(slow, axis=0))[-1, 0]
        assert (gain + 0.5 * K * slow[-1, 0] ** 2 > 0.0) == generates


def rotation(time: Array, spin: float, nod: float) -> tuple[Array, Array, Array]:
    """Return quaternion, twist and exact integral of w of R = R_z(spin t) R_x(nod t).

    Its angular velocity is w = spin z + nod R_z x.
    """
    orientation = (
        Rotation.from_rotvec(np.outer(time, [0, 0, spin]))
        * Rotation.from_rotvec(np.outer(time, [nod, 0, 0]))
    ).as_quat()
    zero = np.zeros_like(time)
    twist = np.column_stack(
        [zero, zero, zero, nod * np.cos(spin * time), nod * np.sin(spin * time), zero + spin]
    )
    integral = np.column_stack(
        [nod * np.sin(spin * time) / spin, nod * (1 - np.cos(spin * time)) / spin, spin * time]
    )
    return orientation, twist, integral


def test_the_integral_of_the_angular_velocity_is_of_fourth_order() -> None:
    errors = []
    for rows in (101, 201):
        time = np.linspace(0.0, 5.0, rows)
        orientation, twist, integral = rotation(time, 0.7, 1.1)
        moved = energy.summed(energy.displacement(time, np.zeros((rows, 3)), orientation, twist))[
            :, 3:
        ]
        errors.append(np.abs(moved - integral).max())
    assert errors[1] < 1e-7
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)


def test_the_virtual_energy_of_a_held_torsion_spring_is_proportional_to_its_period() -> None:
    """This verifies the potential: with a wrong one, the limit for a period of zero is not zero."""
    generated = []
    for rows in (2001, 4001):
        time = np.linspace(0.0, 8.0, rows)
        actual, w, _ = rotation(time, 0.7, 0.4)
        desired, w_d, _ = rotation(time, 0.5, -0.3)
        position = np.zeros((rows, 3))
        error = energy.pose_error(position, actual, position, desired)
        relative = energy.displacement(time, position, actual, w) - energy.displacement(
            time, position, desired, w_d
        )
        worked = energy.work(energy.held(-40.0 * error, 1.0), relative).sum(axis=1)
        stored = energy.spring_energy(np.full(6, 40.0), error).sum(axis=1)
        assert np.ptp(stored) > 10.0
        generated.append(energy.virtual_energy(worked, stored, np.zeros(rows))[-1])
    assert generated[0] > 0.0
    assert generated[0] / generated[1] == pytest.approx(2.0, rel=0.01)


@given(first=st.floats(-10, 10), last=st.floats(-10, 10), samples=st.integers(1, 30))
def test_the_mean_of_held_samples_on_a_line(first: float, last: float, samples: int) -> None:
    each = [first + (last - first) * k / samples for k in range(samples)]
    mean = energy.held(np.array([[first], [last]]), 1.0 / samples)[0, 0]
    assert mean == pytest.approx(sum(each) / samples, abs=1e-12)


@given(st.lists(st.floats(-5, 5), min_size=15, max_size=15))
def test_an_end_effector_wrench_has_the_same_power_at_a_rigidly_connected_base(
    numbers: list[float],
) -> None:
    F, p, twist = np.array(numbers[:6]), np.array(numbers[6:9]), np.array(numbers[9:])
    end_effector = np.concatenate([twist[:3] + np.cross(twist[3:], p), twist[3:]])
    assert energy.at_base(F[None], p[None])[0] @ twist == pytest.approx(F @ end_effector, abs=1e-9)
