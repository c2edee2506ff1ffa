"""Desired end-effector motion through waypoints, for example from a CSV file."""

from __future__ import annotations

import casadi as ca
import numpy as np

from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.blocks.reference_trajectory import moved, reference_outputs, start
from freeflyer_fmus.equations import waypoints
from freeflyer_fmus.robot.robot import Robot

CAPACITY = 32
"""Largest number of waypoints."""


def waypoint_trajectory(robot: Robot) -> Block:
    block = Block(
        "waypoint_trajectory",
        "Desired end-effector motion: a spline through waypoints, with rest at both ends",
    )
    p_0, R_0 = start(block, robot)
    # fmt: off
    times = block.parameter("waypoint_t", np.full(CAPACITY, waypoints.UNUSED), "s", "Times of the waypoints; they increase, and unused ones at the end are -1")
    columns = [
        block.parameter(f"waypoint_{axis}", np.zeros(CAPACITY), "m", f"Displacements along {axis} of I, from the start pose")
        for axis in "xyz"
    ]
    columns += [
        block.parameter(f"waypoint_q{part}", np.full(CAPACITY, float(part == "w")), "1", f"Rotations from the start pose, about axes of I: quaternion, {part}")
        for part in "xyzw"
    ]
    # fmt: on
    points = ca.horzcat(*columns)
    block.require(
        waypoints.order_margin(times, points),
        0.0,
        "the smallest difference between the times of two consecutive waypoints [s]",
        "give each waypoint a time (column t) and sort the waypoints by time; unused ones at the end have the time -1",
        strict=True,
    )
    block.require(
        ca.mmin(ca.sum2(points[:, 3:] ** 2)),
        0.25,
        "the smallest squared norm of a waypoint's quaternion",
        "give each waypoint a quaternion x, y, z, w with the norm 1, or none at all",
    )
    reference_outputs(block, moved(block, waypoints.motion(block.time, times, points, p_0, R_0)))
    return block
