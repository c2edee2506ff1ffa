"""Plant: equation (1) of a free-flying robot under base wrench and joint torques."""

from __future__ import annotations

import numpy as np

from freeflyer_fmus.blocks.block import TWIST, WRENCH, Block
from freeflyer_fmus.blocks.robot_parameters import (
    IDENTITY,
    joint_units,
    mass_parameters,
    require_quaternions,
)
from freeflyer_fmus.blocks.terminals import END_EFFECTOR
from freeflyer_fmus.equations import dynamics, rotation
from freeflyer_fmus.equations.kinematics import end_effector_pose, end_effector_velocity
from freeflyer_fmus.equations.mechanism import State
from freeflyer_fmus.robot.robot import Robot


def free_flyer(robot: Robot) -> Block:
    n = robot.joint_count
    block = Block(
        "free_flyer", f"Free-flying robot {robot.name}: rigid base and {n} joints, no gravity"
    )
    # fmt: off
    block.robot = robot
    mechanism = mass_parameters(block, robot)
    block.integrated_every("integration_step", 1e-3, "Longest step of the Runge-Kutta integration (order 4) inside a communication step")
    # Inputs.
    base_wrench = block.input("base_wrench", np.zeros(6), WRENCH, "F_b: force on the base and torque about B, in I")
    torque = block.input("joint_torque", np.zeros(n), joint_units(robot, "N.m", "N"), "tau: joint torques (forces for prismatic joints)")

    # States.
    position = block.state("base_position", np.zeros(3), "m", "Position of B in I")
    orientation = block.state("base_orientation", IDENTITY, "1", "Orientation of B in I, quaternion x, y, z, w")
    velocity = block.state("base_velocity", np.zeros(6), TWIST, "x_b': velocity of B's origin and angular velocity, in I")
    q = block.state("joint_position", robot.posture, joint_units(robot, "rad", "m"), "q: joint positions")
    qd = block.state("joint_velocity", np.zeros(n), joint_units(robot, "rad/s", "m/s"), "q': joint velocities")
    # fmt: on
    state = State(orientation, velocity[:3], velocity[3:], q, qd)

    # Equation (1).
    block.initial("base_orientation", rotation.normalised(orientation))
    require_quaternions(block, {"base_orientation": orientation}, initially=True)
    base_acceleration, qdd = dynamics.forward_dynamics(mechanism, state, base_wrench, torque)
    block.derivative("base_position", state.v)
    block.derivative("base_orientation", rotation.derivative(orientation, state.w))
    block.derivative("base_velocity", base_acceleration)
    block.derivative("joint_position", qd)
    block.derivative("joint_velocity", qdd)

    # Outputs: end-effector motion, energy and momentum.
    p_e, R_e = end_effector_pose(mechanism, position, orientation, q)
    # fmt: off
    block.output("end_effector_position", p_e, "m", "Position of E in I")
    block.output("end_effector_orientation", R_e, "1", "Orientation of E in I, quaternion x, y, z, w")
    block.output("end_effector_velocity", end_effector_velocity(mechanism, state), TWIST, "x_m': velocity of E, in I")
    block.output("kinetic_energy", dynamics.kinetic_energy(mechanism, state), "J", "Kinetic energy of the whole robot")
    # fmt: on
    linear, angular = dynamics.momentum(mechanism, position, state)
    block.output("linear_momentum", linear, "kg.m/s", "Linear momentum, in I")
    block.output(
        "angular_momentum", angular, "kg.m2/s", "Angular momentum about the origin of I, in I"
    )
    block.terminal("base", "base_position", "base_orientation", "base_velocity", "base_wrench")
    block.terminal("arm", "joint_position", "joint_velocity", "joint_torque")
    block.terminal("hand", **END_EFFECTOR)
    return block
