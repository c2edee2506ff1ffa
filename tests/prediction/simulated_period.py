"""Jacobian of simulated runs by the plant's start: independent reference for the prediction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from freeflyer.master import schedule
from freeflyer.master.master import Master
from freeflyer.scenario import scenario
from freeflyer.scenario.assemble import loaded

Array = NDArray[np.float64]

STATES = ("base_position", "base_orientation", "base_velocity", "joint_position", "joint_velocity")
POSTURE = np.array([0.0, 0.1, -1.6, 0.0, -1.4, 0.0])
QUIET = (
    "manipulator_controller.manipulator_passivity_control=false",
    "manipulator_controller.base_passivity_control=false",
    "reference_trajectory.translation_amplitude=0",
    "reference_trajectory.rotation_amplitude=0",
)
"""Overrides: no passivity controllers, and a constant reference."""


def starting_at(x: Array) -> list[str]:
    """Return overrides for a start at x (24); see `start_values`."""
    return [
        f"free_flyer.{name}={[float(v) for v in value]}" for name, value in start_values(x).items()
    ]


def start_values(x: Array) -> dict[str, Array]:
    """Return start values of the plant for x (24), a small displacement from rest.

    x: base position, rotation vector, base velocity (6), joint positions, joint velocities. SI.
    """
    orientation = Rotation.from_rotvec(x[3:6]).as_quat()
    values = (x[:3], orientation, x[6:12], POSTURE + x[12:18], x[18:24])
    return dict(zip(STATES, values, strict=True))


def displacement(last: Mapping[str, Array]) -> Array:
    """Return x (24) from values of the plant, the inverse of `start_values`."""
    rotation_vector = Rotation.from_quat(last["base_orientation"]).as_rotvec()
    return np.concatenate(
        [
            last["base_position"],
            rotation_vector,
            last["base_velocity"],
            last["joint_position"] - POSTURE,
            last["joint_velocity"],
        ]
    )


def jacobian(name: str, overrides: Sequence[str], time: float, step: float = 1e-6) -> Array:
    """Return d x(`time`) / d x(0) (24, 24) by central differences of runs through the master.

    The FMUs are loaded once, and reset before each run.
    """
    chosen = scenario.load(
        name, [*QUIET, *overrides, f"stop_s={time!r}", f"record.every_s={time!r}"]
    )
    with loaded(chosen) as system:
        plan = schedule.build(
            system.steps, chosen.stop, chosen.record_every, dict.fromkeys(system.components, True)
        )

        def after(x: Array) -> Array:
            for component in system.components.values():
                component._slave.reset()
            master = Master(system.wiring, plan)
            values = {
                **system.values,
                "free_flyer": {**system.values["free_flyer"], **start_values(x)},
            }
            master.initialise(values)
            record = master.run().record
            assert record.time[-1] == time
            return displacement({state: record[f"free_flyer.{state}"][-1] for state in STATES})

        columns = [
            (after(step * direction) - after(-step * direction)) / (2.0 * step)
            for direction in np.eye(24)
        ]
    return np.array(columns).T
