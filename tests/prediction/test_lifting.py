"""Map over a base period, compared with simulated runs and with analytic maps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from simulated_period import QUIET, Array, jacobian

from freeflyer.analysis.prediction import lifting
from freeflyer.analysis.prediction.lifting import Inputs, Instants, Law, Loop, Sample
from freeflyer.analysis.prediction.set_point import at_set_point
from freeflyer.scenario import scenario

NAME = "multirate_unstable"
ROUNDING = 2e-8
"""Tolerance: rounding of the states (about 1e-15) over the step of 1e-6, times the size of the
entries (up to 20). The error of the runs' RK4 is smaller.
"""


@pytest.mark.parametrize(
    ("n", "overrides"),
    [
        (50, ["base_controller.period=0.05"]),
        (300, ["base_controller.period=0.3", "base_controller.discretisation=matched"]),
    ],
    ids=["emulated", "matched"],
)
def test_the_lifted_map_is_the_derivative_of_the_simulated_period(
    n: int, overrides: list[str]
) -> None:
    """Differences of 1e-6 in all 24 directions, simulated by the master with co-simulation FMUs."""
    with at_set_point(scenario.load(NAME, [*QUIET, *overrides])) as here:
        predicted = lifting.lifted(here.loop(n), n).matrix
    simulated = jacobian(NAME, overrides, n / 1000)
    assert predicted.shape == (24, 24)
    assert np.abs(predicted - simulated).max() < ROUNDING


def test_the_lifted_map_is_the_derivative_of_the_simulated_period_in_parallel_exchange() -> None:
    """Two base periods, because the outputs of the first sample act in the second period only."""
    n, overrides = 20, ["base_controller.period=0.02", "exchange=parallel"]
    with at_set_point(scenario.load(NAME, [*QUIET, *overrides])) as here:
        loop = here.loop(n)
    # At initialisation the controllers have already computed their outputs in sequential order.
    instants = Instants(loop)
    rows = np.zeros((instants.size, 24))
    rows[:24] = np.eye(24)
    signals = np.zeros((loop.width, 24))
    signals[: loop.plant.C.shape[0]] = loop.plant.C
    for law in loop.laws:
        signals[law.first : law.last] = law.sample.D @ (
            signals[law.inputs.sources] * ~law.inputs.delayed[:, None]
        )
    rows[instants.pending : instants.pending + loop.width] = signals
    for k in range(2 * n):
        instants.apply(rows, slow=k % n == 0)
    assert np.abs(rows[:24] - jacobian(NAME, overrides, 2 * n / 1000)).max() < ROUNDING


@pytest.mark.parametrize(
    "overrides",
    [
        ["base_controller.period=0.05"],
        [
            "base_controller.period=0.05",
            "base_command_delay.delay==base_controller.period",
            "arm_command_delay.delay=0.001",
        ],
        [
            "base_controller.period=0.04",
            "base_command_delay.delay==base_controller.period",
            "base_controller.command_delay=0.02",
            "base_controller.base_mass=200",
            "manipulator_controller.discretisation=emulated",
        ],
    ],
    ids=[
        "filter",
        "late commands, predicted",
        "late command, prediction of half of it, wrong mass",
    ],
)
def test_the_lifted_map_of_controllers_with_memory_is_the_derivative_of_two_simulated_periods(
    overrides: list[str],
) -> None:
    overrides = [*overrides, "manipulator_controller.filter_without_lag=false"]
    with at_set_point(scenario.load("disturbed", [*QUIET, *overrides])) as here:
        n = here.model.roles.period // here.model.roles.tick
        loop = here.loop(n)
    # The memories are zero at the start. Only the filter starts at its first input u: with
    # z+ = (1 - s) z + s u, its memory before the first sample is u.
    instants = Instants(loop)
    rows = np.zeros((instants.size, 24))
    rows[:24] = np.eye(24)
    instants.apply(started := rows.copy(), slow=True)
    law = next(law for law in loop.laws if law.name == "manipulator_controller")
    filters = instants.memories[loop.laws.index(law)]
    share = 1.0 - np.diag(law.sample.A)
    assert share == pytest.approx(np.full(24, 1.0 / 31.0))
    rows[filters] = started[filters] / share[:, None]
    for k in range(2 * n):
        instants.apply(rows, slow=k % n == 0)
    simulated = jacobian("disturbed", overrides, 2 * n / 1000)
    assert np.abs(rows[:24] - simulated).max() < ROUNDING


def one_axis(
    m: float, k: float, d: float, tick: float, *, delayed: bool = False, parallel: bool = False
) -> Loop:
    """Return the loop of a mass with one slow spring-damper law."""
    plant = lifting.plant(
        np.array([[0.0, 1.0], [0.0, 0.0]]),
        np.array([[0.0], [1.0 / m]]),
        np.eye(2),
        Inputs(sources=np.array([2]), delayed=np.array([delayed])),
        tick,
    )
    spring_damper = lifting.sample(np.array([[-k, -d]]))
    law = Law(
        name="law",
        sample=spring_damper,
        between=spring_damper,
        inputs=Inputs(sources=np.array([0, 1]), delayed=np.zeros(2, dtype=bool)),
        first=2,
        last=3,
        slow=True,
    )
    return Loop(plant=plant, laws=(law,), width=3, tick=tick, parallel=parallel)


def held(m: float, period: float) -> tuple[Array, Array]:
    """Return A (2, 2) and B (2, 1) of a mass over a period with a held force."""
    both = expm(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0 / m], [0.0, 0.0, 0.0]]) * period)
    return both[:2, :2], both[:2, 2:]


@given(
    m=st.floats(0.1, 200.0), k=st.floats(0.0, 500.0), d=st.floats(0.0, 500.0), n=st.integers(1, 400)
)
def test_one_axis_lifts_to_the_held_double_integrator(m: float, k: float, d: float, n: int) -> None:
    A, B = held(m, 1e-3 * n)
    exact = A + B @ np.array([[-k, -d]])
    found = lifting.lifted(one_axis(m, k, d, 1e-3), n).matrix
    assert np.abs(found - exact).max() <= 1e-10 * np.abs(exact).max()


@given(k=st.floats(1.0, 500.0), d=st.floats(1.0, 500.0), n=st.integers(2, 200))
def test_parallel_exchange_delays_the_output_by_one_period(k: float, d: float, n: int) -> None:
    A, B = held(20.0, 1e-3 * n)
    # The state is [x, v, force]; the force acts from the next sample.
    late = np.block([[A, B], [np.array([[-k, -d]]), np.zeros((1, 1))]])
    found = np.sort_complex(
        np.linalg.eigvals(lifting.lifted(one_axis(20.0, k, d, 1e-3, parallel=True), n).matrix)
    )
    exact = np.sort_complex(np.linalg.eigvals(late))
    # The order of complex pairs may differ by rounding; the characteristic polynomial does not.
    assert np.poly(found) == pytest.approx(np.poly(exact), abs=1e-8)


@given(k=st.floats(1.0, 500.0), d=st.floats(1.0, 500.0), n=st.integers(2, 50))
def test_a_delayed_connection_delays_the_output_by_one_step(k: float, d: float, n: int) -> None:
    """The force of the last period still acts in the first T_m of a period."""
    first, rest = held(20.0, 1e-3), held(20.0, 1e-3 * (n - 1))
    gain = np.array([[-k, -d]])
    exact = np.block(
        [
            [rest[0] @ first[0] + rest[1] @ gain, rest[0] @ first[1]],
            [gain, np.zeros((1, 1))],
        ]
    )
    found = lifting.lifted(one_axis(20.0, k, d, 1e-3, delayed=True), n).matrix
    assert np.poly(np.linalg.eigvals(found)) == pytest.approx(
        np.poly(np.linalg.eigvals(exact)), abs=1e-8
    )


@given(k=st.floats(1.0, 500.0), d=st.floats(1.0, 500.0), n=st.integers(1, 60))
def test_a_law_with_a_memory_of_one_command_is_late_by_one_period(
    k: float, d: float, n: int
) -> None:
    """The memory is the command of the last sample. The loop equals that of parallel exchange."""
    gain, one, zero = np.array([[-k, -d]]), np.eye(1), np.zeros((1, 1))
    late = Sample(A=zero, B=gain, C=one, D=np.zeros((1, 2)))
    loop = one_axis(20.0, k, d, 1e-3)
    loop = replace(loop, laws=(replace(loop.laws[0], sample=late, between=late),))
    found = np.linalg.eigvals(lifting.lifted(loop, n).matrix)
    parallel = np.linalg.eigvals(
        lifting.lifted(one_axis(20.0, k, d, 1e-3, parallel=True), n).matrix
    )
    assert np.poly(found) == pytest.approx(np.poly(parallel), abs=1e-8)
    assert late.gain == pytest.approx(gain)


@pytest.mark.parametrize("discretisation", ["emulated", "matched"])
def test_a_scan_gives_the_map_of_every_period(discretisation: str) -> None:
    """The scan updates the power of the fast map; the single maps are computed independently."""
    with at_set_point(
        scenario.load(NAME, [f"base_controller.discretisation={discretisation}"])
    ) as here:
        maps = lifting.lifted_maps(here.loop(n) for n in range(1, 61))
        scanned = [one.matrix for one in maps]
        for n in (1, 2, 17, 60):
            single = lifting.lifted(here.loop(n), n).matrix
            assert np.abs(scanned[n - 1] - single).max() < 1e-11 * np.abs(single).max()
