"""Desired end-effector motion of the facility experiment: a straight line, then rest."""

from __future__ import annotations

import numpy as np

from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.blocks.reference_trajectory import reference_outputs
from freeflyer_fmus.blocks.robot_parameters import IDENTITY, joint_units, require_quaternions
from freeflyer_fmus.equations.kinematics import end_effector_pose
from freeflyer_fmus.equations.mechanism import constant_mechanism
from freeflyer_fmus.equations.trajectory import straight_line
from freeflyer_fmus.robot.robot import Robot


def linear_trajectory(robot: Robot) -> Block:
    block = Block(
        "linear_trajectory",
        "Desired end-effector motion: a straight line from the start posture, then rest",
    )
    # The start pose of the end-effector is computed from the base pose and the joint positions. If
    # the start pose were a parameter, it could contradict them.
    # fmt: off
    p_b = block.parameter("start_base_position", np.zeros(3), "m", "Position of B at t = 0, in I")
    R_b = block.parameter("start_base_orientation", IDENTITY, "1", "Orientation of B at t = 0, quaternion x, y, z, w")
    q = block.parameter("start_joint_position", robot.posture, joint_units(robot, "rad", "m"), "Joint positions at t = 0")
    displacement = block.parameter("displacement", [0.0, 0.0, -0.2], "m", "Displacement of E, in I (paper, Sec. VI)")
    duration = block.parameter("duration", 10.0, "s", "Duration of the motion (paper, Sec. VI)", above=0.0)
    require_quaternions(block, {"start_base_orientation": R_b})
    # fmt: on
    p_0, R_0 = end_effector_pose(constant_mechanism(robot), p_b, R_b, q)
    motion = straight_line(block.time, p_0, R_0, displacement, duration)
    reference_outputs(block, motion)
    return block
