"""Actuators of the base: limits of force and torque, and thrusters that are on or off.

A thruster is switched on at the start of the base controller's period. Its on-time gives the mean
of the commanded wrench over the period. The times are multiples of this block's period.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import WRENCH, Block
from freeflyer_fmus.equations import disturbances
from freeflyer_fmus.robot.robot import Robot

SX = ca.SX
NO_LIMIT = 1e9
"""Default limit of force and torque [SI]."""


def base_actuators(robot: Robot) -> Block:
    del robot
    block = Block("base_actuators", "Wrench on the base through limited or on/off actuators")
    # fmt: off
    T = block.sampled_every("period", 1e-3, "Sampling time: that of the manipulator controller")
    T_b = block.parameter("base_period", 0.3, "s", "T_b: sampling time of the base controller", above=0.0)
    limit = block.parameter("limit", [NO_LIMIT] * 6, WRENCH, "Largest force and torque about each axis of I", minimum=0.0)
    on_off = block.switch("on_off", False, "The actuators are thrusters that are on or off")
    force = block.parameter("thruster_wrench", [10.0] * 3 + [5.0] * 3, WRENCH, "Force and torque of a thruster that is on, about each axis of I", above=0.0)
    shortest = block.parameter("minimum_on_time", 0.02, "s", "Shortest time for which a thruster is on", minimum=0.0)
    commanded = block.input("commanded_base_wrench", np.zeros(6), WRENCH, "Force on the base and torque about B, in I, as commanded")
    # fmt: on
    since = block.time + disturbances.GRID
    since = since - ca.floor(since / T_b) * T_b
    # A time is rounded to a multiple of T: on from sample k if more than half of the sample is on.
    on = since + 0.5 * T < disturbances.on_time(commanded, force, T_b, shortest) + disturbances.GRID
    thrust = ca.if_else(commanded < 0, -1.0, 1.0) * force * on
    wrench = ca.if_else(on_off, thrust, disturbances.saturated(commanded, limit))
    block.output(
        "base_wrench", wrench, WRENCH, "Force on the base and torque about B, in I, as it acts"
    )
    return block
