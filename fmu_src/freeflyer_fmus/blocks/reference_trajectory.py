"""Desired end-effector motion as a function of time. The block has no inputs and no states."""

from __future__ import annotations

import casadi as ca

from freeflyer_fmus.blocks.block import ACCELERATION, TWIST, Block
from freeflyer_fmus.blocks.robot_parameters import require_quaternions, start_pose
from freeflyer_fmus.blocks.terminals import REFERENCE
from freeflyer_fmus.equations.trajectory import Motion, ramped_sine
from freeflyer_fmus.robot.robot import Robot

SX = ca.SX


def reference_motion(block: Block, robot: Robot) -> Motion:
    """Declare the parameters of the trajectory. Return the motion at the block's time."""
    position, orientation = start_pose(robot)
    # fmt: off
    p_0 = block.parameter("initial_position", position, "m", "End-effector position at t = 0, in I")
    R_0 = block.parameter("initial_orientation", orientation, "1", "End-effector orientation at t = 0, quaternion x, y, z, w")
    translation = block.parameter(
        "translation_amplitude",
        [0.15, 0.0, 0.0],
        "m",
        "Amplitude of the translation, in I (assumed; the paper does not give it)",
    )
    rotation_vector = block.parameter(
        "rotation_amplitude", [0.0, 0.2, 0.0], "rad", "Amplitude of the rotation: fixed axis times angle, in I (assumed)"
    )
    frequency = block.parameter("frequency", 0.1, "Hz", "Frequency of the sine (assumed)", minimum=0.0)
    ramp_time = block.parameter("ramp_time", 5.0, "s", "Duration of the quintic ramp of the amplitude (assumed)", above=0.0)
    require_quaternions(block, {"initial_orientation": R_0})
    # fmt: on
    return ramped_sine(block.time, p_0, R_0, translation, rotation_vector, frequency, ramp_time)


def reference_trajectory(robot: Robot) -> Block:
    block = Block(
        "reference_trajectory",
        "Desired end-effector motion: a sine with ramped amplitude along and about fixed axes",
    )
    motion = reference_motion(block, robot)
    block.output("position", motion.position, "m", "x_md: desired position of E in I")
    block.output(
        "orientation",
        motion.orientation,
        "1",
        "Desired orientation of E in I, quaternion x, y, z, w",
    )
    block.output("velocity", motion.velocity, TWIST, "x_md': desired velocity of E, in I")
    block.output(
        "acceleration", motion.acceleration, ACCELERATION, "x_md'': desired acceleration of E, in I"
    )
    block.terminal("reference", *REFERENCE)
    return block
