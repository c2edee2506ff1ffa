"""Desired end-effector motion as a function of time. The block has no inputs and no states."""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import ACCELERATION, TWIST, Block
from freeflyer_fmus.blocks.robot_parameters import require_quaternions, start_pose
from freeflyer_fmus.blocks.terminals import REFERENCE
from freeflyer_fmus.equations import rotation, trajectory
from freeflyer_fmus.equations.trajectory import Motion, Shape
from freeflyer_fmus.robot.robot import Robot

SX = ca.SX
NEVER = 1e9
"""Default start [s] of the fade-out."""


def start(block: Block, robot: Robot) -> tuple[SX, SX]:
    """Declare the start pose of the motion. Return position (3) and quaternion (4), in I."""
    position, orientation = start_pose(robot)
    # fmt: off
    p_0 = block.parameter("initial_position", position, "m", "End-effector position at t = 0, in I")
    R_0 = block.parameter("initial_orientation", orientation, "1", "End-effector orientation at t = 0, quaternion x, y, z, w")
    offset = block.parameter(
        "start_offset", np.zeros(6), ("m",) * 3 + ("rad",) * 3,
        "Offset of the whole desired motion: displacement and rotation vector, in I",
    )
    # fmt: on
    require_quaternions(block, {"initial_orientation": R_0})
    return p_0 + offset[:3], rotation.product(rotation.about(offset[3:]), R_0)


def moved(block: Block, motion: Motion) -> Motion:
    """Declare the drift of the desired motion. Return the motion with this drift."""
    # fmt: off
    drift = block.parameter("drift", np.zeros(6), TWIST, "Constant velocity that is added to the desired motion, in I")
    # fmt: on
    return trajectory.drifting(motion, block.time, drift)


def reference_motion(block: Block, robot: Robot) -> Motion:
    """Declare the parameters of the trajectory. Return the motion at the block's time."""
    p_0, R_0 = start(block, robot)
    # fmt: off
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
    shape = block.choice("shape", Shape, Shape.sine, "Path: `sine` and `circle` are periodic, `hold` stays at the start pose, `line` stops after ramp_time", tunable=False)
    second = block.parameter("second_amplitude", [0.0, 0.15, 0.0], "m", "Second axis of the circle, in I (only shape circle)")
    fade_start = block.parameter("fade_out_start", NEVER, "s", "Start of the fade-out of sine and circle (default: never)", minimum=0.0)
    fade_time = block.parameter("fade_out_time", 5.0, "s", "Duration of the fade-out", above=0.0)
    # fmt: on
    t = block.time
    fade = trajectory.fade_out(t, fade_start, fade_time)
    motion = trajectory.along(
        t, shape, p_0, R_0, translation, second, rotation_vector, frequency, ramp_time, fade
    )
    return moved(block, motion)


def reference_outputs(block: Block, motion: Motion) -> None:
    """Declare the outputs and the terminal of a desired motion, and the preview of the motion.

    The preview is the motion at a later time. A wrench that is held for a period is right on
    average if its feed-forward belongs to the middle of the time in which it acts.
    """
    # fmt: off
    held = block.parameter("preview_period", 0.0, "s", "Period for which a wrench is held that uses the preview", minimum=0.0)
    share = block.parameter("preview_share", 0.5, "1", "Part of preview_period by which the preview is ahead", minimum=0.0)
    delay = block.parameter("preview_delay", 0.0, "s", "Known time until the wrench acts: the preview is ahead by this, too", minimum=0.0)
    block.output("position", motion.position, "m", "x_md: desired position of E in I")
    block.output("orientation", motion.orientation, "1", "Desired orientation of E in I, quaternion x, y, z, w")
    block.output("velocity", motion.velocity, TWIST, "x_md': desired velocity of E, in I")
    block.output("acceleration", motion.acceleration, ACCELERATION, "x_md'': desired acceleration of E, in I")
    later = delay + share * held
    ahead = ca.substitute(ca.vertcat(motion.velocity, motion.acceleration), block.time, block.time + later)
    block.output("preview_velocity", ahead[:6], TWIST, "x_md', preview_time ahead")
    block.output("preview_acceleration", ahead[6:], ACCELERATION, "x_md'', preview_time ahead")
    block.output("preview_time", later, "s", "Time by which the preview is ahead")
    # fmt: on
    block.terminal("reference", *REFERENCE)


def reference_trajectory(robot: Robot) -> Block:
    block = Block(
        "reference_trajectory",
        "Desired end-effector motion: a sine along and about fixed axes, a line, a circle, or rest",
    )
    reference_outputs(block, reference_motion(block, robot))
    return block
