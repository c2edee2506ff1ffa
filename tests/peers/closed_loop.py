"""The compared closed loops: connections and values of two shipped scenarios."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from slaves import Connection, Value

from freeflyer.fmi.component import Array, Port
from freeflyer.scenario.assemble import loaded
from freeflyer.scenario.scenario import load

SCENARIOS = ("multirate_passive", "robust")
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


def connections(scenario: str = "multirate_passive") -> list[Connection]:
    return [(c.source, c.target) for c in load(scenario).connections]


MOVING: dict[str, Value] = {
    "base_position": [0.02, -0.01, 0.0],
    "base_velocity": [0.0, 0.01, 0.0, 0.02, 0.0, 0.0],
}
"""Start values of the plant off the equilibrium. The initial exchange then affects the result."""


def start_values(
    scenario: str = "multirate_passive",
    period: float = 0.3,
    *,
    moving: bool = False,
    base_passivity_control: bool = True,
) -> dict[str, dict[str, Value]]:
    """Return the values of a scenario that differ from the start values of the FMUs."""
    values = {name: dict(own) for name, own in _start_values(scenario, period).items()}
    values["manipulator_controller"]["base_passivity_control"] = base_passivity_control
    if moving:
        values["free_flyer"] = {**values["free_flyer"], **MOVING}
    return values


@cache
def _start_values(scenario: str, period: float) -> dict[str, dict[str, Value]]:
    with loaded(load(scenario, [f"base_controller.period={period}"]), 2) as system:
        return {
            name: {
                parameter: _plain(component.ports[parameter], numbers)
                for parameter, numbers in system.values[name].items()
                if not _is_start(component.ports[parameter], numbers)
            }
            for name, component in system.components.items()
        }


def _is_start(port: Port, numbers: Array) -> bool:
    return port.start is not None and np.array_equal(port.start, numbers)


def _plain(port: Port, numbers: Array) -> Value:
    """Return the value of an FMI variable: Boolean, number of an enumeration's item, or Real."""
    items = [bool(x) if port.boolean else int(x) if port.choices else float(x) for x in numbers]
    return items if len(items) > 1 else items[0]


def steps(base: float = 0.001) -> dict[str, float]:
    return {name: base if name == "base_controller" else 0.001 for name in COMPONENTS}
