"""A base wrench that acts one period late: the input of the previous sample, and first zero."""

from __future__ import annotations

import numpy as np

from freeflyer_fmus.blocks.block import WRENCH, Block
from freeflyer_fmus.robot.robot import Robot


def block(robot: Robot) -> Block:
    del robot
    made = Block("late_wrench", "Base wrench that acts one period late")
    made.sampled_every("period", 0.3, "Sampling time")
    commanded = made.input("commanded", np.zeros(6), WRENCH, "Commanded wrench")
    previous = made.state(
        "previous", np.zeros(6), WRENCH, "Wrench of the previous sample", local=True
    )
    made.update("previous", commanded)
    made.output("wrench", previous, WRENCH, "Wrench that acts now")
    return made
