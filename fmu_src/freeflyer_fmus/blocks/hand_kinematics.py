"""Pose and velocity of the end-effector, computed from the measured motion of base and joints.

The facility has no direct measurement of the end-effector.
"""

from __future__ import annotations

import numpy as np

from freeflyer_fmus.blocks.block import TWIST, Block
from freeflyer_fmus.blocks.robot_parameters import measured_state, require_quaternions
from freeflyer_fmus.blocks.terminals import END_EFFECTOR
from freeflyer_fmus.equations.kinematics import end_effector_pose, end_effector_velocity
from freeflyer_fmus.equations.mechanism import constant_mechanism
from freeflyer_fmus.robot.robot import Robot


def hand_kinematics(robot: Robot) -> Block:
    block = Block(
        "hand_kinematics",
        "End-effector pose and velocity from the measured motion of base and joints",
    )
    block.robot = robot
    block.sampled_every("period", 1e-3, "Sampling time, equal to the cycle of the arm")
    p_b = block.input("base_position", np.zeros(3), "m", "Measured position of B in I")
    state = measured_state(block, robot)
    mechanism = constant_mechanism(robot)
    p_e, R_e = end_effector_pose(mechanism, p_b, state.orientation, state.q)
    block.output("end_effector_position", p_e, "m", "Position of E in I")
    block.output(
        "end_effector_orientation", R_e, "1", "Orientation of E in I, quaternion x, y, z, w"
    )
    block.output(
        "end_effector_velocity",
        end_effector_velocity(mechanism, state),
        TWIST,
        "x_m': velocity of E, in I",
    )
    require_quaternions(block, {"base_orientation": state.orientation})
    block.terminal("base", "base_position", "base_orientation", "base_velocity")
    block.terminal("arm", "joint_position", "joint_velocity")
    block.terminal("hand", **END_EFFECTOR)
    return block
