"""Blocks shipped with this package, by name."""

from __future__ import annotations

from collections.abc import Callable

from freeflyer_fmus.blocks.arm_drive import arm_drive
from freeflyer_fmus.blocks.base_actuators import base_actuators
from freeflyer_fmus.blocks.base_controller import base_controller
from freeflyer_fmus.blocks.base_robot import base_robot
from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.blocks.command_delay import arm_command_delay, base_command_delay
from freeflyer_fmus.blocks.continuous_loop import continuous_loop
from freeflyer_fmus.blocks.disturbance import disturbance
from freeflyer_fmus.blocks.free_flyer import free_flyer
from freeflyer_fmus.blocks.hand_kinematics import hand_kinematics
from freeflyer_fmus.blocks.linear_trajectory import linear_trajectory
from freeflyer_fmus.blocks.manipulator_controller import manipulator_controller
from freeflyer_fmus.blocks.measurement_noise import measurement_noise
from freeflyer_fmus.blocks.reference_trajectory import reference_trajectory
from freeflyer_fmus.blocks.satellite import satellite
from freeflyer_fmus.blocks.waypoint_trajectory import waypoint_trajectory
from freeflyer_fmus.robot.robot import Robot

BLOCKS: dict[str, Callable[[Robot], Block]] = {
    block.__name__: block
    for block in (
        free_flyer,
        reference_trajectory,
        manipulator_controller,
        base_controller,
        continuous_loop,
        linear_trajectory,
        waypoint_trajectory,
        hand_kinematics,
        satellite,
        arm_drive,
        base_robot,
        disturbance,
        measurement_noise,
        base_command_delay,
        arm_command_delay,
        base_actuators,
    )
}
