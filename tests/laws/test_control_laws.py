"""Control laws: (7) and (8) against their matrices, (15) and W along the exact closed loop."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from families import family
from robots import ROBOTS
from scipy.integrate import solve_ivp

from freeflyer_fmus.blocks.continuous_loop import continuous_loop
from freeflyer_fmus.equations import task_space, tracking_control
from freeflyer_fmus.equations.mechanism import State, constant_mechanism
from freeflyer_fmus.robot.robot import Robot
from freeflyer_fmus.robot.urdf import load_robot_file

SX = ca.SX


def state_symbols(n: int) -> tuple[list[SX], State]:
    o, v, q, qd = (SX.sym(name, size) for name, size in (("o", 4), ("v", 6), ("q", n), ("qd", n)))
    return [o, v, q, qd], State(o, v[:3], v[3:], q, qd)


@pytest.mark.parametrize("name", ["lwr4", "ur5", "gantry"])
def test_feed_forward_equals_the_reference_columns_of_M_and_Gamma(name: str) -> None:
    robot = ROBOTS[name]()
    arguments, s = state_symbols(robot.joint_count)
    xd, xdd = SX.sym("xd", 6), SX.sym("xdd", 6)
    m = constant_mechanism(robot)
    star = tracking_control.feed_forward(m, s, xd, xdd)
    M, Gamma = task_space.inertia_and_coriolis_in_task_space(m, s)
    zero = SX(6, 1)
    expected = M @ ca.vertcat(zero, xdd) + Gamma @ ca.vertcat(zero, xd)
    both = ca.Function("f", [*arguments, xd, xdd], [ca.vertcat(star.F_b, star.F_m), expected])
    random = np.random.default_rng(3)
    for _ in range(20):
        o = random.normal(size=4)
        posture = robot.posture + random.uniform(-0.1, 0.1, robot.joint_count)
        values = [
            o / np.linalg.norm(o),
            random.normal(size=6),
            posture,
            *random.normal(size=(3, 6)),
        ]
        found, matrices = (np.array(part).ravel() for part in both(*values))
        assert np.abs(found - matrices).max() <= 1e-11 * np.abs(matrices).max()


def test_M_is_symmetric_and_its_rate_minus_twice_Gamma_is_skew(robot: Robot) -> None:
    arguments, s = state_symbols(6)
    m = constant_mechanism(robot)
    M, Gamma = task_space.inertia_and_coriolis_in_task_space(m, s)
    f = ca.Function("f", arguments, [M, Gamma, task_space.rate(m, M, s)])
    random = np.random.default_rng(4)
    values = [
        np.array([0.1, -0.2, 0.3, 0.9]) / np.sqrt(0.95),
        random.normal(size=6),
        robot.posture,
        random.normal(size=6),
    ]
    M, Gamma, rate = (np.array(part) for part in f(*values))
    assert np.abs(M - M.T).max() < 1e-11 * np.abs(M).max()
    N = rate - 2 * Gamma
    assert np.abs(N + N.T).max() < 1e-10 * np.abs(Gamma).max()


class Loop:
    """The continuous closed loop with V, dV/dt by the chain rule, and the dissipated power."""

    def __init__(self, robot: Robot) -> None:
        self.block, self.joints = continuous_loop(robot), robot.joint_count
        block = self.block
        t, p, u, x = block.arguments
        rates = block.functions["derivatives"](t, p, u, x)
        outputs, _ = block.functions["outputs"](t, p, u, x)
        V = outputs[block.offset("lyapunov_function")]
        dissipated = outputs[block.offset("dissipated_power")]
        dV = ca.jtimes(V, x, rates) + ca.jtimes(V, t, SX(1))
        self.p = block.start_values("parameter")
        self.rates = ca.Function("rates", [t, p, x], [rates], {"allow_free": False})
        self.V = ca.Function("V", [t, p, x], [V, dV, dissipated])

    def start(self, seed: int) -> np.ndarray:
        """Return random nonzero errors and velocities near the start posture."""
        random = np.random.default_rng(seed)
        x = self.block.start_values("state").copy()
        x[:3] += random.uniform(-0.05, 0.05, 3)
        o = np.concatenate([random.uniform(-0.1, 0.1, 3), [1.0]])
        x[3:7] = o / np.linalg.norm(o)
        x[7:13] = random.uniform(-0.05, 0.05, 6)
        n = self.joints
        x[13 : 13 + n] += random.uniform(-0.05, 0.05, n)
        x[13 + n :] = random.uniform(-0.1, 0.1, n)
        return x

    def solve(self, seed: int, stop: float) -> tuple[np.ndarray, np.ndarray]:
        solution = solve_ivp(
            lambda t, x: np.array(self.rates(t, self.p, x)).ravel(),
            (0.0, stop),
            self.start(seed),
            method="DOP853",
            rtol=1e-11,
            atol=1e-13,
            t_eval=np.linspace(0.0, stop, 60),
        )
        assert solution.success
        return solution.t, solution.y


@cache
def loop_of(name: str) -> Loop:
    return Loop(ROBOTS[name]())


@pytest.mark.parametrize("seed", family(range(4)))
@pytest.mark.parametrize("name", family(["lwr4", "lwr4_redundant"]))
def test_V_decreases_as_in_equation_15(name: str, seed: int) -> None:
    """With seven joints, the null-space damper adds to (15)."""
    loop = loop_of(name)
    times, states = loop.solve(seed, 6.0)
    values = np.array(
        [
            [float(part) for part in loop.V(t, loop.p, x)]
            for t, x in zip(times, states.T, strict=True)
        ]
    )
    V, dV, dissipated = values.T
    assert V[0] > 1e-3, "the start must have an error"
    assert (np.diff(V) < 0.0).all()
    assert np.abs(dV + dissipated).max() <= 1e-7 * dissipated.max()


@pytest.mark.slow
def test_rate_of_W_is_the_papers_expression_and_negative_where_V_is_constant() -> None:
    """W = dx^T M dx'. The paper's d(dx)/dt = dx' is exact for rotations to first order only."""
    # Errors and error rates as functions of the loop's states.
    robot = load_robot_file()
    loop = loop_of("lwr4")
    block = loop.block
    t, p, u, x = block.arguments
    o, v, q, qd = x[3:7], x[7:13], x[13:19], x[19:25]
    m = constant_mechanism(robot)
    s = State(o, v[:3], v[3:], q, qd)
    outputs, _ = block.functions["outputs"](t, p, u, x)

    def out(name: str, size: int) -> SX:
        return outputs[block.offset(name) : block.offset(name) + size]

    dx_m = tracking_control.pose_error(
        out("end_effector_position", 3),
        out("end_effector_orientation", 4),
        out("desired_position", 3),
        out("desired_orientation", 4),
    )
    dx_b = tracking_control.pose_error(x[:3], o, SX(3, 1), SX([0, 0, 0, 1]))
    desired_velocity = ca.jtimes(out("desired_position", 3), t, SX(1))
    quaternion_rate = ca.jtimes(out("desired_orientation", 4), t, SX(1))
    w_d = 2 * (
        out("desired_orientation", 4)[3] * quaternion_rate[:3]
        - quaternion_rate[3] * out("desired_orientation", 4)[:3]
        + ca.cross(out("desired_orientation", 4)[:3], quaternion_rate[:3])
    )
    error_rate = ca.vertcat(v, out("end_effector_velocity", 6) - ca.vertcat(desired_velocity, w_d))
    error = ca.vertcat(dx_b, dx_m)
    # dW/dt by the chain rule, by the paper, and by the paper with the exact error rate.
    M, Gamma = task_space.inertia_and_coriolis_in_task_space(m, s)
    rates = block.functions["derivatives"](t, p, u, x)
    W = ca.dot(error, M @ error_rate)
    dW = ca.jtimes(W, x, rates) + ca.jtimes(W, t, SX(1))
    gain = {
        name: p[block.offset(name) : block.offset(name) + 6]
        for name in (
            "base_stiffness",
            "manipulator_stiffness",
            "base_damping",
            "manipulator_damping",
        )
    }
    K = ca.vertcat(gain["base_stiffness"], gain["manipulator_stiffness"])
    D = ca.vertcat(gain["base_damping"], gain["manipulator_damping"])
    M_rate = task_space.rate(m, M, s)
    true_error_rate = ca.jtimes(error, x, rates) + ca.jtimes(error, t, SX(1))
    spring = ca.dot(error, -K * error - D * error_rate + (M_rate - Gamma) @ error_rate)
    f = ca.Function(
        "W",
        [t, p, x],
        [
            dW,
            ca.dot(error_rate, M @ error_rate) + spring,
            ca.dot(true_error_rate, M @ error_rate) + spring,
            ca.dot(error, K * error),
        ],
    )
    times, states = loop.solve(1, 4.0)
    for at, state in zip(times[1:], states.T[1:], strict=True):
        exact, paper, with_true_rate, stored = (float(part) for part in f(at, loop.p, state))
        scale = abs(exact) + stored
        assert abs(exact - with_true_rate) <= 1e-7 * scale
        assert abs(exact - paper) <= 0.05 * scale
    # V is constant at x_b' = dx_m' = 0. If errors remain there, dW/dt = -dx^T K dx < 0.
    state = loop.start(2)
    state[7:13] = 0.0
    state[19:25] = 0.0
    exact, _, _, stored = (float(part) for part in f(0.0, loop.p, state))
    assert stored > 0.0
    assert exact == pytest.approx(-stored, rel=1e-9)


def test_the_singular_value_bound_is_tight_near_a_singularity() -> None:
    random = np.random.default_rng(5)
    J = SX.sym("J", 6, 6)
    f = ca.Function(
        "s", [J], [tracking_control.smallest_singular_value(tracking_control.left_inverse(J))]
    )
    for smallest in (0.5, 0.1, 0.02, 0.005):
        U, _, V = np.linalg.svd(random.normal(size=(6, 6)))
        matrix = U @ np.diag([2.0, 1.5, 1.0, 0.8, 0.5, smallest]) @ V
        found = float(f(matrix))
        assert 0.79 * smallest <= found <= smallest * (1 + 1e-9)
        if smallest <= 0.1:
            assert found == pytest.approx(smallest, rel=1e-3)
