"""Null space of a redundant manipulator: Pinocchio's matrices, effect on the end-effector."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from robots import SHIPPED, lwr4_redundant

from freeflyer.scenario import experiment, scenario
from freeflyer_fmus.blocks.manipulator_controller import manipulator_controller
from freeflyer_fmus.equations.dynamics import arm_on_moving_base
from freeflyer_fmus.equations.kinematics import (
    axes,
    manipulator_jacobian,
    manipulator_jacobian_rate_times,
)
from freeflyer_fmus.equations.mechanism import State, constant_mechanism
from freeflyer_fmus.equations.redundancy import consistent_inverse, reference_acceleration
from freeflyer_fmus.errors import RobotError
from freeflyer_fmus.in_process_block import InProcessBlock
from freeflyer_fmus.robot.robot import Array
from freeflyer_fmus.robot.urdf import load_urdf

SX = ca.SX
ROBOT = lwr4_redundant()
N = ROBOT.joint_count
MECHANISM = constant_mechanism(ROBOT)


def pinocchio_matrices(q: Array) -> tuple[Array, Array]:
    """Return H_q and J_m (in B's axes) by Pinocchio's URDF parser, with a fixed base."""
    model = pin.buildModelFromUrdf(str(SHIPPED / "lwr4_free_flyer.urdf"))
    data = model.createData()
    tip = model.getFrameId("end_effector")
    H = np.array(pin.crba(model, data, q))
    H = np.triu(H) + np.triu(H, 1).T
    J = np.array(
        pin.computeFrameJacobian(model, data, q, tip, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    )
    return H, J


def functions() -> ca.Function:
    q, torque = SX.sym("q", N), SX.sym("torque", N)
    at = consistent_inverse(MECHANISM, q)
    return ca.Function("f", [q, torque], [at.H, at.Jm, at.inverse, at.torque_in_null_space(torque)])


@pytest.mark.parametrize("seed", range(10))
def test_the_inverse_is_weighted_with_the_manipulators_inertia(seed: int) -> None:
    random = np.random.default_rng(seed)
    q, torque = ROBOT.posture + random.uniform(-0.4, 0.4, N), random.normal(size=N)
    H, J = pinocchio_matrices(q)
    generated = [np.array(part) for part in functions()(q, torque)]
    weighted = np.linalg.solve(H, J.T)
    inverse = weighted @ np.linalg.inv(J @ weighted)
    for found, expected in zip(
        generated, (H, J, inverse, (torque - J.T @ (inverse.T @ torque))[:, None]), strict=True
    ):
        assert np.abs(found - expected).max() <= 1e-10 * np.abs(expected).max()


@pytest.mark.parametrize("seed", range(5))
def test_a_null_space_torque_does_not_move_the_end_effector_of_a_base_at_rest(seed: int) -> None:
    random = np.random.default_rng(seed)
    q, qd = ROBOT.posture + random.uniform(-0.4, 0.4, N), random.normal(size=N)
    s = State(SX([0, 0, 0, 1]), SX(3, 1), SX(3, 1), SX(q), SX(qd))
    torque = SX.sym("torque", N)
    at = consistent_inverse(MECHANISM, SX(q))
    still = SX(6, 1)
    accelerations = [
        arm_on_moving_base(MECHANISM, s, still, applied, SX(3, 1))
        for applied in (SX(N, 1), at.torque_in_null_space(torque))
    ]
    moved = ca.Function(
        "f",
        [torque],
        [at.Jm @ (accelerations[1] - accelerations[0]), accelerations[1] - accelerations[0]],
    )
    end_effector, joints = (np.array(part) for part in moved(random.normal(size=N)))
    assert np.abs(joints).max() > 0.1
    assert np.abs(end_effector).max() < 1e-11 * np.abs(joints).max()


def test_the_reference_acceleration_is_the_derivative_of_the_reference_velocity() -> None:
    random = np.random.default_rng(2)
    q, qd = SX.sym("q", N), SX.sym("qd", N)
    u, du = random.normal(size=6), random.normal(size=6)
    s = State(SX([0, 0, 0, 1]), SX(3, 1), SX(3, 1), q, qd)
    at = consistent_inverse(MECHANISM, q)
    exact = ca.jtimes(at.inverse @ SX(u), q, qd) + at.inverse @ SX(du)
    f = ca.Function("f", [q, qd], [reference_acceleration(MECHANISM, s, at, SX(u), SX(du)), exact])
    found, derivative = (np.array(part) for part in f(ROBOT.posture + 0.1, random.normal(size=N)))
    np.testing.assert_allclose(found, derivative, rtol=1e-10, atol=1e-10)
    # Its part along the task is the derivative of J_m q_r'.
    rate = manipulator_jacobian_rate_times(
        MECHANISM, axes(MECHANISM, q), SX(3, 1), SX(3, 1), qd, at.inverse @ SX(u)
    )
    task = ca.Function(
        "t", [q, qd], [manipulator_jacobian(MECHANISM, axes(MECHANISM, q)) @ exact + rate]
    )
    np.testing.assert_allclose(
        np.array(task(ROBOT.posture + 0.1, random.normal(size=N))).ravel(), du, rtol=1e-9, atol=1e-9
    )


def test_seven_joints_track_like_six_and_the_null_space_comes_to_rest(tmp_path: Path) -> None:
    """The paper's multi-rate loop with the redundant arm, with in-process blocks."""
    components = "\n".join(
        f'[components.{name}]\nkind = "twin"\nrobot = "lwr4_redundant"'
        for name in (
            "free_flyer",
            "reference_trajectory",
            "manipulator_controller",
            "base_controller",
        )
    )
    text = f'extends = "multirate_passive"\nstop_s = 6.0\n{components}\n'
    (tmp_path / "seven.toml").write_text(text)
    velocity = "[0, 0, 0.3, 0, 0, 0, 0]"  # of the elbow: mostly in the null space
    chosen = scenario.load(str(tmp_path / "seven.toml"), [f"free_flyer.joint_velocity={velocity}"])
    result = experiment.run(chosen)
    assert result.outcome.cause is None
    position = (
        result.outcome.record["free_flyer.end_effector_position"]
        - result.outcome.record["reference_trajectory.position"]
    )
    late = result.outcome.record.time > 4.0
    assert np.abs(position[late]).max() < 2e-3
    q, qd = SX.sym("q", N), SX.sym("qd", N)
    f = ca.Function("f", [q, qd], [consistent_inverse(MECHANISM, q).velocity_in_null_space(qd)])
    record = result.outcome.record
    idle = np.array(
        f(record["free_flyer.joint_position"].T, record["free_flyer.joint_velocity"].T)
    ).T
    assert np.abs(idle[0]).max() > 0.1
    assert np.abs(idle[late]).max() < 0.01
    assert np.abs(result.outcome.record["free_flyer.base_position"]).max() < 0.02


def test_a_null_space_spring_pulls_only_towards_its_posture() -> None:
    """The torque difference of two controllers with and without spring is P K (q_0 - q)."""
    torques = []
    for stiffness in (0.0, 5.0):
        controller = InProcessBlock(manipulator_controller(ROBOT))
        controller.enter_initialization(
            0.0,
            {
                "null_space_stiffness": np.full(N, stiffness),
                "null_space_posture": ROBOT.posture + 0.2,
            },
        )
        controller.exit_initialization()
        controller.step(0.0, 1e-3)
        torques.append(controller.value("joint_torque").copy())
    H, J = pinocchio_matrices(ROBOT.posture)
    weighted = np.linalg.solve(H, J.T)
    inverse = weighted @ np.linalg.inv(J @ weighted)
    spring = np.full(N, 5.0 * 0.2)
    np.testing.assert_allclose(
        torques[1] - torques[0], spring - J.T @ (inverse.T @ spring), atol=1e-9
    )


def test_fewer_than_six_joints_are_rejected() -> None:
    robot = load_urdf(
        SHIPPED / "lwr4_free_flyer.urdf",
        base_link="base",
        end_effector="end_effector",
        lock={"joint_e1": 0.0, "joint_a4": 0.0},
        posture=[0.0, 0.1, -1.6, -1.4, 0.0],
    )
    with pytest.raises(
        RobotError,
        match="needs at least six free joints so that the end-effector can move in all directions, got 5",
    ):
        manipulator_controller(robot)
