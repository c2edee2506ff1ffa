"""Robots for the tests of the equations."""

from __future__ import annotations

from importlib.metadata import distribution
from pathlib import Path
from typing import Any

from freeflyer_fmus.robot.robot import Robot
from freeflyer_fmus.robot.urdf import ROBOTS as SHIPPED
from freeflyer_fmus.robot.urdf import load_robot_file, load_urdf

DATA = Path(__file__).parent / "data"


def example(name: str) -> Path:
    files = distribution("example-robot-data").files or []
    return Path(str(next(file.locate() for file in files if file.name == name)))


FOREIGN: dict[str, tuple[str, dict[str, Any]]] = {
    "ur5": ("ur5_robot.urdf", {"base_link": "base_link", "end_effector": "tool0"}),
    "xarm7": ("xarm7.urdf", {"base_link": "link_base"}),
    "ur10": ("ur10_robot.urdf", {"base_link": "base_link", "end_effector": "tool0"}),
    "z1": ("z1.urdf", {"base_link": "link00", "lock": {"jointGripper": -0.3}}),
    "kinova": (
        "kinova.urdf",
        {"base_link": "j2s6s200_link_base", "end_effector": "j2s6s200_end_effector"},
    ),
}
"""Robots of example-robot-data: URDF, and the options of `load_robot`."""


def ur5_path() -> Path:
    return example("ur5_robot.urdf")


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
