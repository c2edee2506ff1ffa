"""Draw the figures of the paper from records.

The quantities, axes and units are the same as in the paper. The figures have the width of one or
two printed columns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from scipy.spatial.transform import Rotation

from freeflyer.fmi.component import Array
from freeflyer.master.record import Record
from freeflyer.scenario.figure_style import LINES

XYZ = ("x", "y", "z")
YPR = (r"$\psi$ (yaw)", r"$\theta$ (pitch)", r"$\phi$ (roll)")


def orientation_error_angles(actual: Array, desired: Array) -> Array:
    """Return yaw, pitch, roll (rows, 3) [deg] of the rotation from desired to actual orientation.

    `actual` and `desired` are quaternions [x, y, z, w] (rows, 4) in the inertial frame I.
    """
    relative = Rotation.from_quat(actual) * Rotation.from_quat(desired).inv()
    return np.asarray(relative.as_euler("ZYX", degrees=True))


def panel(axes: Any, time: Array, values: Array, names: Sequence[str], label: str) -> None:
    """Draw the columns of `values` (rows, n) over `time` [s]. `label` is the label of the y axis.

    `names` are the names of the columns.
    """
    for column, name, line in zip(values.T, names, LINES, strict=True):
        axes.plot(time, column, label=name, **line)
    axes.set_ylabel(label)
    # The legend is above the axes. Inside the axes it would hide lines.
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 0.97),
        ncols=3,
        frameon=False,
        handlelength=1.8,
        columnspacing=1.0,
    )


def two_by_two(
    time: Array, rows: Sequence[tuple[str, Sequence[tuple[Array, Sequence[str], str]]]]
) -> Any:
    """Draw a figure with two rows and two columns of panels.

    The rows are for example manipulator and base. The columns are translation and rotation.
    `rows` contains (title, panels) for each row. `panels` contains (values (n, 3), names, label)
    for each column.
    """
    figure, grid = plt.subplots(2, 2, figsize=(7.0, 3.9), sharex=True)
    for axes_row, (title, panels) in zip(grid, rows, strict=True):
        for axes, (values, names, label) in zip(axes_row, panels, strict=True):
            panel(axes, time, values, names, f"{title}\n{label}")
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
        axes.set_xlim(time[0], time[-1])
    return figure


def overview(cases: Sequence[tuple[str, Array, Mapping[str, Array]]]) -> Any:
    """Draw the errors of end-effector and base over time, with one line per case.

    A case is (label, time [s], errors). The keys of the errors are their names in summary.json.
    """
    figure, grid = plt.subplots(1, 2, figsize=(7.0, 2.6), sharex=True)
    quantities = (
        ("end_effector_position_error_m", "end-effector position error [m]"),
        ("base_orientation_error_deg", "base rotation error [deg]"),
    )
    for axes, (name, label) in zip(grid, quantities, strict=True):
        for (case, time, errors), line in zip(cases, LINES, strict=True):
            axes.semilogy(time, errors[name], label=case, **line)
        axes.set_ylabel(label)
        axes.set_xlabel("time [s]")
        axes.set_ylim(
            bottom=1e-8 if name.endswith("_m") else 1e-6, top=1.0 if name.endswith("_m") else 1e3
        )
    grid[0].legend(loc="upper right")
    return figure


def trajectory(record: Record) -> Any:
    """Draw Fig. 2: desired position x and orientation theta of the end-effector."""
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(3.5, 3.0), sharex=True)
    time = record.time
    position = record["reference_trajectory.position"]
    start = Rotation.from_quat(record["reference_trajectory.orientation"][0])
    angles = (
        Rotation.from_quat(record["reference_trajectory.orientation"]) * start.inv()
    ).as_rotvec(degrees=True)
    top.plot(time, position[:, 0], **LINES[0])
    top.set_ylabel(r"$x_{md}$ [m]")
    bottom.plot(time, angles[:, 1], **LINES[1])
    bottom.set_ylabel(r"$\theta_{md}$ [deg]")
    bottom.set_xlabel("time [s]")
    bottom.set_xlim(time[0], time[-1])
    return figure


def errors(record: Record, plant: str = "free_flyer") -> Any:
    """Draw Figs. 3, 4, 10: errors of the end-effector (top) and the base (bottom).

    Position is on the left, orientation on the right. The set point of the base is the origin of I.
    `plant` is the component whose outputs are the motion of the robot: `free_flyer`, or the
    component of the whole loop in continuous time.
    """
    actual = (f"{plant}.end_effector_position", f"{plant}.end_effector_orientation")
    if plant == "free_flyer":
        desired = ("reference_trajectory.position", "reference_trajectory.orientation")
    else:
        desired = (f"{plant}.desired_position", f"{plant}.desired_orientation")
    base = record[f"{plant}.base_orientation"]
    setpoint = np.broadcast_to([0.0, 0.0, 0.0, 1.0], base.shape)
    return two_by_two(
        record.time,
        [
            (
                "end-effector",
                [
                    (record[actual[0]] - record[desired[0]], XYZ, r"$\Delta p_m$ [m]"),
                    (
                        orientation_error_angles(record[actual[1]], record[desired[1]]),
                        YPR,
                        r"$\Delta\Phi_m$ [deg]",
                    ),
                ],
            ),
            (
                "base",
                [
                    (record[f"{plant}.base_position"], XYZ, r"$\Delta p_b$ [m]"),
                    (orientation_error_angles(base, setpoint), YPR, r"$\Delta\Phi_b$ [deg]"),
                ],
            ),
        ],
    )


def _both(
    record: Record, manipulator: str, base: str, labels: Sequence[str], units: Sequence[str]
) -> Any:
    def half(signal: str, first: int) -> Array:
        return np.asarray(record[signal][:, first : first + 3])

    rows = []
    for title, signal, label in (
        ("manipulator", manipulator, labels[0]),
        ("base", base, labels[1]),
    ):
        panels = [
            (half(signal, 0), XYZ, f"{label} {units[0]}"),
            (half(signal, 3), tuple(f"about {axis}" for axis in XYZ), f"{label} {units[1]}"),
        ]
        rows.append((title, panels))
    return two_by_two(record.time, rows)


def energies(record: Record) -> Any:
    """Draw Figs. 7, 9, 13, 14: observed energies of manipulator (top) and base (bottom).

    There is one line per degree of freedom. The energies include E(0).
    """
    return _both(
        record,
        "manipulator_controller.manipulator_observed_energy",
        "manipulator_controller.base_observed_energy",
        ("$E_m$", "$E_b$"),
        ("[J]", "[J]"),
    )


def facility_manipulator(record: Record) -> Any:
    """Draw Fig. 11: tracking error of the end-effector (top) and wrench F'_m (bottom)."""
    position = (
        record["hand_kinematics.end_effector_position"] - record["reference_trajectory.position"]
    )
    orientation = record["hand_kinematics.end_effector_orientation"]
    angles = orientation_error_angles(orientation, record["reference_trajectory.orientation"])
    return _error_and_force(
        record, "m", position, angles, record["manipulator_controller.end_effector_wrench"]
    )


def facility_base(record: Record) -> Any:
    """Draw Fig. 12: regulation error of the base (top) and wrench F'_b (bottom).

    The base starts at its set point.
    """
    position, orientation = (
        record["base_robot.base_position"],
        record["base_robot.base_orientation"],
    )
    angles = orientation_error_angles(
        orientation, np.broadcast_to(orientation[0], orientation.shape)
    )
    return _error_and_force(
        record, "b", position - position[0], angles, record["base_controller.base_wrench"]
    )


def _error_and_force(
    record: Record, which: str, position: Array, angles: Array, wrench: Array
) -> Any:
    about = tuple(f"about {axis}" for axis in XYZ)
    errors_row = [
        (position, XYZ, rf"$\Delta p_{which}$ [m]"),
        (angles, YPR, rf"$\Delta\Phi_{which}$ [deg]"),
    ]
    forces_row = [
        (wrench[:, :3], XYZ, f"$f'_{which}$ [N]"),
        (wrench[:, 3:], about, rf"$\tau'_{which}$ [N m]"),
    ]
    return two_by_two(record.time, [("error", errors_row), ("force", forces_row)])


def corrections(record: Record) -> Any:
    """Draw Fig. 8: passivity controllers' wrenches at manipulator (top) and base (bottom)."""
    return _both(
        record,
        "manipulator_controller.passivity_wrench",
        "base_controller.passivity_wrench",
        ("$F_{pcm}$", "$F_{pcb}$"),
        ("[N]", "[N m]"),
    )
