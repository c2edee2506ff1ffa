"""Independent reference implementation of the dynamics with Pinocchio.

The Pinocchio model is built from the same `Robot` object as the FMUs, without a URDF file.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from freeflyer_fmus.equations.dynamics import forward_dynamics
from freeflyer_fmus.equations.mechanism import State, constant_mechanism
from freeflyer_fmus.robot.robot import Array, Inertial, Robot

SX = ca.SX


def pinocchio_model(robot: Robot) -> Any:
    """Build a Pinocchio model of the robot without gravity.

    The model has a free-flyer joint, followed by the joints of the robot.
    """
    import pinocchio as pin

    def inertia(body: Inertial) -> Any:
        return pin.Inertia(body.mass, np.array(body.centre_of_mass), np.array(body.inertia))

    model = pin.Model()
    model.gravity.setZero()
    parent = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(parent, inertia(robot.base), pin.SE3.Identity())
    if robot.base_attachment.mass > 0.0:
        model.appendBodyToJoint(parent, inertia(robot.base_attachment), pin.SE3.Identity())
    for joint, body in zip(robot.joints, robot.bodies, strict=True):
        kind = pin.JointModelRZ() if joint.kind == "revolute" else pin.JointModelPZ()
        parent = model.addJoint(
            parent, kind, pin.SE3(np.array(joint.rotation), np.array(joint.translation)), joint.name
        )
        if body.mass > 0.0:
            model.appendBodyToJoint(parent, inertia(body), pin.SE3.Identity())
    end_effector = pin.SE3(
        np.array(robot.end_effector_rotation), np.array(robot.end_effector_translation)
    )
    if robot.tool.mass > 0.0:
        model.appendBodyToJoint(parent, inertia(robot.tool), end_effector)
    model.addFrame(pin.Frame("end_effector", parent, end_effector, pin.FrameType.OP_FRAME))
    return model


def accelerations(
    model: Any,
    orientation: Array,
    velocity: Array,
    q: Array,
    qd: Array,
    wrench: Array,
    torque: Array,
) -> Array:
    """Return x_b'' (6, in I) and q'' (n), by Pinocchio's articulated-body algorithm.

    `orientation` is the quaternion (4) of the base. `velocity` (6) and `wrench` (6) are those of
    the base, in I. `torque` (n) is the torque of the joints.
    """
    import pinocchio as pin

    R = pin.Quaternion(np.array(orientation)).matrix()
    v, w = R.T @ velocity[:3], R.T @ velocity[3:]
    configuration = np.concatenate([np.zeros(3), orientation, q])
    a = pin.aba(
        model,
        model.createData(),
        configuration,
        np.concatenate([v, w, qd]),
        np.concatenate([R.T @ wrench[:3], R.T @ wrench[3:], torque]),
    )
    return np.concatenate([R @ (a[:3] + np.cross(w, v)), R @ a[3:6], a[6:]])


def disagreement(robot: Robot, states: int = 20, seed: int = 1) -> float:
    """Compare the forward dynamics of dynamics.py with Pinocchio's.

    Returns the largest relative difference of the accelerations at `states` random states. `seed`
    is the seed of the random numbers. The export of FMUs for a user's robot calls this function
    before it writes the first file.
    """
    n = robot.joint_count
    names = {"orientation": 4, "velocity": 6, "q": n, "qd": n, "wrench": 6, "torque": n}
    s = {name: SX.sym(name, size) for name, size in names.items()}
    state = State(s["orientation"], s["velocity"][:3], s["velocity"][3:], s["q"], s["qd"])
    generated = ca.Function(
        "f",
        list(s.values()),
        [ca.vertcat(*forward_dynamics(constant_mechanism(robot), state, s["wrench"], s["torque"]))],
    )
    model, random, worst = pinocchio_model(robot), np.random.default_rng(seed), 0.0
    for _ in range(states):
        arguments = {name: random.normal(size=size) for name, size in names.items()}
        arguments["orientation"] /= np.linalg.norm(arguments["orientation"])
        reference = accelerations(model, *arguments.values())
        difference = np.array(generated(*arguments.values())).ravel() - reference
        worst = max(worst, float(np.abs(difference).max() / np.abs(reference).max()))
    return worst
