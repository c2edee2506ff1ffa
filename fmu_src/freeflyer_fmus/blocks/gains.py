"""Gains of the two control laws. The paper gives no gains. The defaults are assumptions."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.blocks.robot_parameters import joint_units
from freeflyer_fmus.robot.robot import Robot

SX = ca.SX
STIFFNESS = ("N/m",) * 3 + ("N.m/rad",) * 3
DAMPING = ("N.s/m",) * 3 + ("N.m.s/rad",) * 3
# Default gains of each control law: stiffness and damping.
MANIPULATOR = ([500.0] * 3 + [50.0] * 3, [80.0] * 3 + [3.0] * 3)
BASE = ([150.0] * 3 + [40.0] * 3, [10.0] * 3 + [2.0] * 3)


class Gains(NamedTuple):
    """Diagonals of K_P and K_D (6 each), in I."""

    stiffness: SX
    damping: SX


def gains(block: Block, default: tuple[list[float], list[float]], prefix: str = "") -> Gains:
    """Declare the parameters PREFIXstiffness and PREFIXdamping.

    `default` contains the start values of both parameters, in this order.
    """
    stiffness, damping = default
    return Gains(
        block.parameter(
            f"{prefix}stiffness",
            stiffness,
            STIFFNESS,
            "Diagonal of K_P, in I (assumed)",
            tunable=True,
            minimum=0.0,
        ),
        block.parameter(
            f"{prefix}damping",
            damping,
            DAMPING,
            "Diagonal of K_D, in I (assumed)",
            tunable=True,
            minimum=0.0,
        ),
    )


def mean_weight(block: Block) -> SX:
    """Declare theta of the matched law (`sampled_control.mean_wrench`)."""
    # fmt: off
    description = "theta of the matched law: 0.5 is the mean over the period; up to 1 adds numerical damping"
    theta = block.parameter("theta", 0.5, "1", description, tunable=True, minimum=0.5)
    # fmt: on
    block.require(1.0 - theta, 0.0, "1 minus the parameter theta", "choose theta from 0.5 to 1")
    return theta


def null_space_damping(block: Block, robot: Robot) -> SX:
    """Declare the null-space damping (n) of a redundant manipulator.

    For six joints, nothing is declared and the result is an empty vector.
    """
    if robot.joint_count == 6:
        return SX(0, 1)
    units = joint_units(robot, "N.m.s/rad", "N.s/m")
    description = (
        "Joint damping in the null space of J_m (extension of the paper to more than six joints)"
    )
    return block.parameter(
        "null_space_damping",
        [1.0] * robot.joint_count,
        units,
        description,
        tunable=True,
        minimum=0.0,
    )


def null_space_spring(block: Block, robot: Robot) -> tuple[SX, SX]:
    """Declare the stiffness (n) and the rest posture (n) of the null-space spring.

    For six joints, nothing is declared and the results are empty vectors.
    """
    if robot.joint_count == 6:
        return SX(0, 1), SX(0, 1)
    units, zero = joint_units(robot, "N.m/rad", "N/m"), [0.0] * robot.joint_count
    stiffness = "Joint stiffness in the null space of J_m (extension of the paper; with 0 there is no spring and V of (10) decreases)"
    return (
        block.parameter("null_space_stiffness", zero, units, stiffness, tunable=True, minimum=0.0),
        block.parameter(
            "null_space_posture",
            robot.posture,
            joint_units(robot, "rad", "m"),
            "Rest posture of the null-space spring",
            tunable=True,
        ),
    )
