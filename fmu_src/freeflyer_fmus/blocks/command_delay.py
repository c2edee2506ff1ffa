"""Delay of a command by one period of the controller that gives it."""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import WRENCH, Block
from freeflyer_fmus.blocks.robot_parameters import joint_units
from freeflyer_fmus.equations.disturbances import GRID
from freeflyer_fmus.robot.robot import Robot


def base_command_delay(robot: Robot) -> Block:
    del robot
    block = Block(
        "base_command_delay", "Base wrench that acts one period of the base controller later"
    )
    delayed(block, 0.3, "base_wrench", 6, WRENCH, "Force on the base and torque about B, in I")
    return block


def arm_command_delay(robot: Robot) -> Block:
    units = joint_units(robot, "N.m", "N")
    block = Block("arm_command_delay", "Joint torques that act one period of the controller later")
    delayed(block, 1e-3, "joint_torque", robot.joint_count, units, "tau: joint torques")
    return block


def delayed(
    block: Block, command_period: float, name: str, size: int, unit: tuple[str, ...], what: str
) -> None:
    """Declare the signal NAME: the output is the input `commanded_NAME` of the last command.

    Without a delay, the output equals the input at every sample of the block.
    """
    # fmt: off
    block.sampled_every("period", 1e-3, "Sampling time: that of the manipulator controller")
    T = block.parameter("command_period", command_period, "s", "Period of the controller that gives the command", above=0.0)
    delay = block.parameter("delay", 0.0, "s", "Delay of the command: 0 or command_period", minimum=0.0)
    block.require(
        ca.if_else(delay > 0, 1e-9 - ca.fabs(delay - T), 0.0), 0.0, "1 ns minus the difference of delay and command_period [s]",
        "set delay to 0 or to command_period",
    )
    commanded = block.input(f"commanded_{name}", np.zeros(size), unit, f"{what}, as commanded")
    present = block.state("present", np.zeros(size), unit, "Command of the present period", local=True)
    before = block.state("before", np.zeros(size), unit, "Command of the period before; at first 0", local=True)
    # fmt: on
    since = block.time + GRID
    is_new = since - ca.floor(since / T) * T < 2.0 * GRID
    late = ca.if_else(is_new, present, before)
    block.update("present", ca.if_else(is_new, commanded, present))
    block.update("before", late)
    block.output(name, ca.if_else(delay > 0, late, commanded), unit, f"{what}, as it acts")
