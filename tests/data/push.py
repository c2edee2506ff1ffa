"""A push: a torque on joint 2 from 10 s on, for 0.1 s."""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.robot.robot import Robot


def block(robot: Robot) -> Block:
    n = robot.joint_count
    made = Block("push", "Joint torque with a push")
    commanded = made.input("commanded", np.zeros(n), "N.m", "Commanded torque")
    size = made.parameter("size", 2.0, "N.m", "Torque of the push")
    made.sampled_every("period", 1e-3, "Sampling time")
    acts = ca.logic_and(made.time >= 10.0 - 1e-9, made.time < 10.1 - 1e-9)
    torque = ca.SX(commanded)
    torque[1] += ca.if_else(acts, size, 0.0)
    made.output("torque", torque, ("N.m",) * n, "Torque on the joints")
    return made
