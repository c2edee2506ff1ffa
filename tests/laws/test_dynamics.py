"""Equations of motion against Pinocchio, which parses the same URDF."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robots import DATA, ROBOTS, ur5_path

from freeflyer_fmus.equations import dynamics, kinematics, rotation, task_space
from freeflyer_fmus.equations.mechanism import State, constant_mechanism
from freeflyer_fmus.equations.pinocchio_reference import disagreement
from freeflyer_fmus.robot.robot import Robot
from freeflyer_fmus.robot.urdf import ROBOTS as SHIPPED_ROBOTS

SX = ca.SX
TOLERANCE = 1e-11


class PinocchioReference:
    """Pinocchio's model of a URDF, as an independent reference implementation.

    Its base frame is the base link's frame; B is at the base body's centre of mass `c`.
    """

    def __init__(self, path: Path, locked: dict[str, float], end_effector: str, root: str) -> None:
        model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
        q = pin.neutral(model)
        for name, value in locked.items():
            q[model.joints[model.getJointId(name)].idx_q] = value
        self.model = pin.buildReducedModel(model, [model.getJointId(name) for name in locked], q)
        self.model.gravity.setZero()
        self.data = self.model.createData()
        self.frame = self.model.getFrameId(end_effector)
        link = next(
            link
            for link in ElementTree.parse(path).getroot().findall("link")
            if link.get("name") == root
        )
        origin = link.find("inertial/origin")
        self.c = np.array(
            [
                float(x)
                for x in (origin.get("xyz", "0 0 0") if origin is not None else "0 0 0").split()
            ]
        )

    def configuration(self, s: Sample) -> tuple[np.ndarray, np.ndarray]:
        R = pin.Quaternion(s.orientation).matrix()
        q = pin.integrate(self.model, pin.neutral(self.model), np.concatenate([np.zeros(6), s.q]))
        q[:3] = -R @ self.c
        q[3:7] = s.orientation
        v = R.T @ s.velocity[:3] - np.cross(R.T @ s.velocity[3:], self.c)
        return q, np.concatenate([v, R.T @ s.velocity[3:], s.qd])

    def to_inertial(self, s: Sample) -> np.ndarray:
        """Return T: [v; w; q'] of Pinocchio (link axes, link origin) = T [v_b; w_b; q'] (I, B)."""
        R, n = pin.Quaternion(s.orientation).matrix(), len(s.q)
        T = np.eye(6 + n)
        T[:3, :3], T[3:6, 3:6] = R.T, R.T
        T[:3, 3:6] = pin.skew(self.c) @ R.T
        return T


class Sample(NamedTuple):
    orientation: np.ndarray
    velocity: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    wrench: np.ndarray
    torque: np.ndarray


def sample(seed: int, n: int) -> Sample:
    random = np.random.default_rng(seed)
    o = random.normal(size=4)
    return Sample(
        o / np.linalg.norm(o),
        random.normal(size=6),
        random.uniform(-3, 3, n),
        random.normal(size=n),
        random.normal(size=6),
        random.normal(size=n),
    )


class Generated(NamedTuple):
    forward: Any
    matrices: Any
    jacobians: Any
    rates: Any


def functions(robot: Robot) -> Generated:
    n = robot.joint_count
    m = constant_mechanism(robot)
    o, v, q, qd = (SX.sym(name, size) for name, size in (("o", 4), ("v", 6), ("q", n), ("qd", n)))
    F, tau, y = SX.sym("F", 6), SX.sym("tau", n), SX.sym("y", n)
    s = State(o, v[:3], v[3:], q, qd)
    Jb, Jm = task_space.jacobians(m, s)
    R = rotation.matrix(o)
    R_6 = ca.diagcat(R, R)
    dJm_y = R_6 @ kinematics.manipulator_jacobian_rate_times(
        m, kinematics.axes(m, q), R.T @ s.v, R.T @ s.w, qd, y
    )
    p, Q = kinematics.end_effector_pose(m, SX(3, 1), o, q)
    return Generated(
        ca.Function(
            "f", [o, v, q, qd, F, tau], [ca.vertcat(*dynamics.forward_dynamics(m, s, F, tau))]
        ),
        ca.Function(
            "h",
            [o, v, q, qd],
            [
                *dynamics.inertia_and_coriolis(m, s),
                dynamics.articulated_base_inertia(m, q).matrix(),
                dynamics.articulated_end_effector_inertia(m, s),
                ca.horzcat(Jb, Jm),
            ],
        ),
        ca.Function("j", [o, v, q, qd], [Jb, Jm, kinematics.end_effector_velocity(m, s), p, Q]),
        ca.Function("r", [o, v, q, qd, y], [dJm_y, task_space.rate(m, Jm, s) @ y]),
    )


@cache
def case(name: str) -> tuple[Robot, PinocchioReference, Generated]:
    robot = ROBOTS[name]()
    path, locked, tip, root = {
        "lwr4": (
            SHIPPED_ROBOTS / "lwr4_free_flyer.urdf",
            {"joint_e1": 0.0},
            "end_effector",
            "base",
        ),
        "ur5": (ur5_path(), {}, "tool0", "base_link"),
        "lwr4_redundant": (SHIPPED_ROBOTS / "lwr4_free_flyer.urdf", {}, "end_effector", "base"),
        "gantry": (DATA / "gantry.urdf", {"swivel": 0.4}, "hand", "bus"),
    }[name]
    return robot, PinocchioReference(path, locked, tip, root), functions(robot)


CASES = ("lwr4", "ur5", "gantry", "lwr4_redundant")


def close(generated: object, expected: np.ndarray) -> None:
    generated = np.array(generated).reshape(expected.shape)
    assert np.abs(generated - expected).max() <= TOLERANCE * max(np.abs(expected).max(), 1e-3)


@pytest.mark.parametrize("name", CASES)
@given(seed=st.integers(0, 2**32 - 1))
def test_forward_dynamics_agree_with_pinocchio(name: str, seed: int) -> None:
    robot, reference, generated = case(name)
    s = sample(seed, robot.joint_count)
    q, v = reference.configuration(s)
    T = reference.to_inertial(s)
    # A wrench about the centre of mass does the same work in both coordinates.
    acceleration = pin.aba(
        reference.model,
        reference.data,
        q,
        v,
        np.linalg.solve(T.T, np.concatenate([s.wrench, s.torque])),
    )
    R = pin.Quaternion(s.orientation).matrix()
    alpha = R @ acceleration[3:6]
    w, c = s.velocity[3:], R @ reference.c
    origin = R @ (acceleration[:3] + np.cross(v[3:6], v[:3]))
    expected = np.concatenate(
        [origin + np.cross(alpha, c) + np.cross(w, np.cross(w, c)), alpha, acceleration[6:]]
    )
    close(generated.forward(s.orientation, s.velocity, s.q, s.qd, s.wrench, s.torque), expected)


@pytest.mark.parametrize("name", CASES)
@given(seed=st.integers(0, 2**32 - 1))
def test_inertia_matrix_and_coriolis_forces_agree_with_pinocchio(name: str, seed: int) -> None:
    robot, reference, generated = case(name)
    s = sample(seed, robot.joint_count)
    q, v = reference.configuration(s)
    T = reference.to_inertial(s)
    H_pin = pin.crba(reference.model, reference.data, q)
    H_pin = np.triu(H_pin) + np.triu(H_pin, 1).T
    H, C, M_base, M_e, J = (
        np.array(part) for part in generated.matrices(s.orientation, s.velocity, s.q, s.qd)
    )
    close(H, T.T @ H_pin @ T)
    # At zero acceleration of B in I, the spatial acceleration of Pinocchio's base is not zero.
    R = pin.Quaternion(s.orientation).matrix()
    w, c = R.T @ s.velocity[3:], reference.c
    a = np.zeros(len(v))
    a[:3] = -np.cross(w, np.cross(w, c)) - np.cross(w, v[:3])
    close(
        C @ np.concatenate([s.velocity, s.qd]),
        T.T @ pin.rnea(reference.model, reference.data, q, v, a),
    )
    # M~, the base inertia at zero joint torques, is the inverse of the base block of H^-1.
    R_6 = np.kron(np.eye(2), R)
    close(R_6 @ M_base @ R_6.T, np.linalg.inv(np.linalg.inv(H)[:6, :6]))
    # The end-effector inertia, with zero base wrench and joint torques.
    close(np.linalg.inv(M_e), J @ np.linalg.inv(H) @ J.T)


@pytest.mark.parametrize("name", CASES)
@given(seed=st.integers(0, 2**32 - 1))
def test_jacobians_and_their_rates_agree_with_pinocchio(name: str, seed: int) -> None:
    robot, reference, generated = case(name)
    s = sample(seed, robot.joint_count)
    q, v = reference.configuration(s)
    T = reference.to_inertial(s)
    frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    pin.computeJointJacobiansTimeVariation(reference.model, reference.data, q, v)
    pin.updateFramePlacements(reference.model, reference.data)
    J = pin.getFrameJacobian(reference.model, reference.data, reference.frame, frame)
    dJ = pin.getFrameJacobianTimeVariation(reference.model, reference.data, reference.frame, frame)
    Jb, Jm, velocity, p, Q = (
        np.array(part) for part in generated.jacobians(s.orientation, s.velocity, s.q, s.qd)
    )
    close(np.hstack([Jb, Jm]), J @ T)
    close(velocity.ravel(), J @ v)
    close(p.ravel(), reference.data.oMf[reference.frame].translation)
    close(
        np.array(pin.Quaternion(Q.ravel()).matrix()), reference.data.oMf[reference.frame].rotation
    )
    y = np.random.default_rng(seed).normal(size=len(s.q))
    recursion, symbolic = generated.rates(s.orientation, s.velocity, s.q, s.qd, y)
    expected = dJ[:, 6:] @ y
    close(symbolic, expected)
    close(recursion, expected)


@pytest.mark.parametrize("name", CASES)
@given(seed=st.integers(0, 2**32 - 1))
def test_rate_of_H_minus_twice_C_is_skew(name: str, seed: int) -> None:
    robot, _, generated = case(name)
    s = sample(seed, robot.joint_count)
    H, C, *_ = (np.array(part) for part in generated.matrices(s.orientation, s.velocity, s.q, s.qd))
    rate = np.array(rate_of_H(name)(s.orientation, s.velocity, s.q, s.qd))
    N = rate - 2 * C
    assert np.abs(N + N.T).max() <= TOLERANCE * np.abs(C).max()
    assert np.linalg.eigvalsh(H)[0] > 0.0


@cache
def rate_of_H(name: str) -> Any:
    robot, _, _ = case(name)
    n = robot.joint_count
    o, v, q, qd = (SX.sym(name, size) for name, size in (("o", 4), ("v", 6), ("q", n), ("qd", n)))
    s = State(o, v[:3], v[3:], q, qd)
    m = constant_mechanism(robot)
    H, _ = dynamics.inertia_and_coriolis(m, s)
    return ca.Function("dH", [o, v, q, qd], [task_space.rate(m, H, s)])


def test_the_check_of_user_robots_against_pinocchio_succeeds(any_robot: Robot) -> None:
    assert disagreement(any_robot) < 1e-12
