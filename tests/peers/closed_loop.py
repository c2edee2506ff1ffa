"""The compared closed loop: the connections of the shipped scenario `multirate_passive`."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path

from slaves import Connection, Value

COMPONENTS = ("manipulator_controller", "base_controller", "free_flyer", "reference_trajectory")
"""Controllers first: the order of a sequential exchange."""
RECORDED = (
    "free_flyer.end_effector_position",
    "free_flyer.base_position",
    "free_flyer.joint_velocity",
    "reference_trajectory.position",
    "manipulator_controller.joint_torque",
    "base_controller.base_wrench",
)


def fmus(version: int) -> dict[str, Path]:
    folder = Path(str(files("freeflyer_fmus"))) / "prebuilt" / f"fmi{version}"
    return {name: folder / f"{name}.fmu" for name in COMPONENTS}


def connections() -> list[Connection]:
    text = (
        Path(str(files("freeflyer"))) / "paper" / "scenarios" / "_free_flyer_loop.toml"
    ).read_text()
    loop = tomllib.loads(text)
    found = []
    for line in (*loop["connections"], *loop["delayed"]):
        source, _, targets = line.partition(" -> ")
        found += [(source, target.strip()) for target in targets.split(",")]
    return found


def start_values(
    period: float = 0.3, *, moving: bool = False, base_passivity_control: bool = True
) -> dict[str, dict[str, Value]]:
    """Return the start values; `moving` starts off the equilibrium.

    The initial exchange then affects the result.
    """
    values: dict[str, dict[str, Value]] = {
        "manipulator_controller": {
            "period": 0.001,
            "base_period": period,
            "base_passivity_control": base_passivity_control,
        },
        "base_controller": {"period": period},
    }
    if moving:
        values["free_flyer"] = {
            "base_position": [0.02, -0.01, 0.0],
            "base_velocity": [0.0, 0.01, 0.0, 0.02, 0.0, 0.0],
        }
    return values


def steps(base: float = 0.001) -> dict[str, float]:
    return {name: base if name == "base_controller" else 0.001 for name in COMPONENTS}
