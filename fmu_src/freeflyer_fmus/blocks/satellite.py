"""Simulated satellite: motion of the base for the measured motion and torques of the joints.

The motion follows from equation (1) of the paper. The facility's base robot follows this motion.
The pose and the velocity of the satellite are the set point of the base robot.
"""

from __future__ import annotations

import numpy as np

from freeflyer_fmus.blocks.block import ACCELERATION, TWIST, WRENCH, Block
from freeflyer_fmus.blocks.facility_parameters import gravity_model, gravity_parameters
from freeflyer_fmus.blocks.robot_parameters import (
    IDENTITY,
    joint_units,
    mass_parameters,
    require_quaternions,
)
from freeflyer_fmus.equations import dynamics, rotation
from freeflyer_fmus.equations.mechanism import State
from freeflyer_fmus.robot.robot import Robot


def satellite(robot: Robot) -> Block:
    n = robot.joint_count
    block = Block(
        "satellite",
        "Base dynamics in free flight, computed from the measured arm and the commanded base wrench",
    )
    # fmt: off
    block.robot = robot
    mechanism = mass_parameters(block, robot)
    gravity, knowledge = gravity_parameters(block)
    # Inputs: commanded base wrench and measurements of arm and base robot.
    F_b = block.input("base_wrench", np.zeros(6), WRENCH, "F_b: force on the base and torque about B, in I")
    q = block.input("joint_position", robot.posture, joint_units(robot, "rad", "m"), "Measured joint positions")
    qd = block.input("joint_velocity", np.zeros(n), joint_units(robot, "rad/s", "m/s"), "Measured joint velocities")
    measured = block.input(
        "joint_torque", np.zeros(n), joint_units(robot, "N.m", "N"), "Measured joint torques; they include the gravity torque"
    )
    R_robot = block.input("measured_base_orientation", IDENTITY, "1", "Orientation of the base robot, used for the gravity torque")

    # States: the set point of the base robot.
    block.state("base_position", np.zeros(3), "m", "Position of B in I (set point of the base robot)")
    R = block.state("base_orientation", IDENTITY, "1", "Orientation of B in I, quaternion x, y, z, w (set point)")
    v = block.state("base_velocity", np.zeros(6), TWIST, "Velocity of B, in I (set point)")
    # fmt: on
    state = State(R, v[:3], v[3:], q, qd)
    # The measured torque includes the gravity torque. Gravity does not act on the satellite.
    # Therefore the modelled gravity torque is subtracted. The parameter `knowledge` is the
    # ratio of the modelled gravity torque to the true one.
    torque = measured - knowledge * gravity_model(mechanism, R_robot, q, gravity)
    acceleration, _ = dynamics.forward_dynamics(mechanism, state, F_b, torque)
    block.initial("base_orientation", rotation.normalised(R))
    block.derivative("base_position", state.v)
    block.derivative("base_orientation", rotation.derivative(R, state.w))
    block.derivative("base_velocity", acceleration)
    block.output("base_acceleration", acceleration, ACCELERATION, "Acceleration of B, in I")
    require_quaternions(
        block, {"base_orientation": R, "measured_base_orientation": R_robot}, initially=True
    )
    block.terminal("base", "base_wrench")
    block.terminal("arm", "joint_position", "joint_velocity", measured_joint_torque="joint_torque")
    return block
