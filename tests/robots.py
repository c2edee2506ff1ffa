"""Robots for the tests of the equations."""

from __future__ import annotations

from importlib.metadata import distribution
from pathlib import Path

from freeflyer_fmus.robot.robot import Robot
from freeflyer_fmus.robot.urdf import ROBOTS as SHIPPED
from freeflyer_fmus.robot.urdf import load_robot_file, load_urdf

DATA = Path(__file__).parent / "data"


def ur5_path() -> Path:
    shipped = distribution("example-robot-data").files or []
    return Path(str(next(file.locate() for file in shipped if file.name == "ur5_robot.urdf")))


def ur5() -> Robot:
    """Return the UR5 of example-robot-data as a free-flyer; its rpy angles are rounded."""
    return load_urdf(
        ur5_path(),
        base_link="base_link",
        end_effector="tool0",
        posture=[0.3, -1.2, 1.4, 0.2, 1.1, -0.4],
    )


def gantry() -> Robot:
    """Return a robot with geometry that the other robots do not have.

    It has prismatic and revolute joints on skew axes, a base whose centre of mass is not at its
    origin, a side branch, and a locked joint.
    """
    return load_urdf(
        DATA / "gantry.urdf",
        end_effector="hand",
        tool_link="gripper",
        lock={"swivel": 0.4},
        posture={
            "slide_x": 0.1,
            "slide_y": -0.2,
            "turn_1": 0.3,
            "turn_2": -0.7,
            "turn_3": 0.5,
            "turn_4": 0.9,
        },
    )


def lwr4_redundant() -> Robot:
    """Return the shipped robot with all seven joints."""
    return load_robot_file(SHIPPED / "lwr4_redundant.toml")


ROBOTS = {"lwr4": load_robot_file, "ur5": ur5, "gantry": gantry, "lwr4_redundant": lwr4_redundant}
