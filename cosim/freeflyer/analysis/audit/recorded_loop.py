"""Find the signals of the control loop in a record.

A record contains its provenance. The provenance contains the connections, parameters and steps of
the system that was run. The signals are found by these connections.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeflyer.analysis.audit import energy
from freeflyer.fmi.component import Array
from freeflyer.foundation.errors import RecordError
from freeflyer.foundation.signal_name import component_of
from freeflyer.master.provenance import Provenance
from freeflyer.master.record import Record

MANIPULATOR = (
    "joint_torque",
    "end_effector_wrench",
    "passivity_wrench",
    "manipulator_observed_energy",
    "base_observed_energy",
)
BASE = ("base_wrench", "port_wrench", "passivity_wrench")
"""Outputs that identify the base controller. `MANIPULATOR` identifies the manipulator controller.

The names of the two components do not matter.
"""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Position (n, 3) [m], quaternion (n, 4) [x, y, z, w] and velocity (n, 6) [m/s, rad/s].

    All values are expressed in the inertial frame I.
    """

    position: Array
    orientation: Array
    velocity: Array


@dataclass(frozen=True, kw_only=True)
class Law:
    """Control law of one controller.

    `period` is in ns. `stiffness` and `damping` are the diagonals of K_P and K_D (6,).
    `initial_energy` is E(0) (6,) [J]. `measured` is the motion that the controller measures.
    `is_plain` is true if the controller uses K_P and K_D themselves. It is false if the controller
    computes discrete gains from K_P and K_D.
    """

    period: int
    stiffness: Array
    damping: Array
    initial_energy: Array
    measured: Motion
    is_plain: bool


@dataclass(frozen=True, kw_only=True)
class Plant:
    """Inputs that the simulated robot received, and its response.

    The inputs are `base_wrench` (n, 6) [N, N m] and `joint_torque` (n, joints) [N m]. The period of
    an input is the step [ns] of the component that is connected to it. The response is
    `joint_position` (n, joints) [rad] and `kinetic_energy` (n,) [J].
    """

    base_wrench: Array
    base_wrench_period: int
    joint_torque: Array
    joint_torque_period: int
    joint_position: Array
    kinetic_energy: Array


@dataclass(frozen=True, kw_only=True)
class RecordedLoop:
    """Signals of the control loop, for the first rows of a record.

    A row is invalid if a value is not finite, or if the norm of a quaternion is almost zero. The
    first invalid row and all later rows are left out. Their number is `rows_left_out`. `time` is
    (n,) [s]. fmu_src/NOTATION.md defines the wrenches. `base` and `end_effector` are the actual
    motions, `desired` is the desired motion of the end-effector, and `setpoint` is the desired
    motion of the base. A record of the facility has no simulated robot. Then `plant` is None, and
    `base` and `end_effector` are the measured motions.
    """

    provenance: Provenance
    time: Array
    base: Motion
    end_effector: Motion
    desired: Motion
    setpoint: Motion
    manipulator_law: Law
    base_law: Law
    end_effector_wrench: Array
    manipulator_passivity_wrench: Array
    joint_torque: Array
    base_wrench: Array
    port_wrench: Array
    base_passivity_wrench: Array
    manipulator_observed_energy: Array
    base_observed_energy: Array
    observer: str
    plant: Plant | None
    rows_left_out: int

    @property
    def interval(self) -> int:
        """Time between two rows [ns]. The last interval may be shorter."""
        return round(float(self.time[1] - self.time[0]) * 1e9)

    @property
    def sampled_at_end(self) -> bool:
        """Whether controllers have sampled at the time of the last row (`Provenance`)."""
        return self.provenance.sampled_at_end or self.rows_left_out > 0

    def last_samples(self, values: Array, period: int) -> Array:
        """Return for each row the values (n, m) at the last sample of a controller.

        The controller samples every `period` [ns]. `energy.last_samples` has the details.
        """
        return energy.last_samples(self.time, values, period, sampled_at_end=self.sampled_at_end)

    def held(self, values: Array, period: int) -> Array:
        """Return the mean (n - 1, m) of a sampled and held output in each interval.

        The sampling period is `period` [ns]. `energy.held` has the details.
        """
        share = min(1.0, period / self.interval)
        return energy.held(values, share, sampled_at_end=self.sampled_at_end)


def find(record: Record) -> RecordedLoop:
    """Return the control loop in a record.

    Raises RecordError if data are missing. The message lists all missing data.
    """
    provenance = record.provenance
    if provenance is None:
        raise RecordError("the record has no provenance; a record of `freeflyer run` is expected")
    if provenance.exchange != "sequential":
        raise RecordError(
            f"the record of {provenance.scenario} was simulated with exchange = {provenance.exchange!r}; the audit needs 'sequential', "
            f"because with {provenance.exchange!r} the outputs belong to an earlier sample"
        )
    loop = _Finder(record, provenance).loop()
    if loop.time.size < 2:
        raise RecordError(
            f"the record of {provenance.scenario} has {loop.time.size} finite rows; at least 2 are needed"
        )
    if not (np.diff(loop.time) >= 1e-9).all():
        raise RecordError(
            f"the times in the record of {provenance.scenario} do not increase by at least 1 ns from row to row"
        )
    return loop


class _Finder:
    """Reader of the signals of the loop. It collects all missing data for one error message."""

    def __init__(self, record: Record, provenance: Provenance) -> None:
        self.record, self.provenance = record, provenance
        self.missing: list[str] = []
        self.rows = record.rows

    def loop(self) -> RecordedLoop:
        # Both controllers must be found first. All other signals are outputs of these controllers,
        # or are found by connections.
        manipulator, base = (
            self.component_with(MANIPULATOR, "manipulator's"),
            self.component_with(BASE, "base's"),
        )
        self.check_complete()
        plant = self.plant_component()

        # Read the commanded outputs of the controllers.
        joint_torque = self.signal(f"{manipulator}.joint_torque")
        joints = joint_torque.shape[1]
        wrenches = [
            self.signal(name, 6)
            for name in [f"{manipulator}.{output}" for output in MANIPULATOR[1:]]
            + [f"{base}.{output}" for output in BASE]
        ]

        # Read the motions that the controllers measured. Read the desired motion of the
        # end-effector.
        measured_base = self.motion(
            self.source(base, "base_position"),
            self.source(manipulator, "base_orientation"),
            self.source(manipulator, "base_velocity"),
        )
        measured_end_effector = self.motion(
            *(
                self.source(manipulator, f"end_effector_{part}")
                for part in ("position", "orientation", "velocity")
            )
        )
        desired = self.motion(
            *(
                self.source(manipulator, f"desired_{part}")
                for part in ("position", "orientation", "velocity")
            )
        )

        # If the record has a simulated plant, read its true motions, inputs and kinetic energy.
        true_base, true_end_effector = (
            self.motion(
                *(f"{plant}.{which}_{part}" for part in ("position", "orientation", "velocity"))
            )
            if plant
            else None
            for which in ("base", "end_effector")
        )
        actual = (
            Plant(
                base_wrench=self.signal(self.source(plant, "base_wrench"), 6),
                base_wrench_period=self.period(self.source(plant, "base_wrench")),
                joint_torque=self.signal(self.source(plant, "joint_torque"), joints),
                joint_torque_period=self.period(self.source(plant, "joint_torque")),
                joint_position=self.signal(f"{plant}.joint_position", joints),
                kinetic_energy=self.signal(f"{plant}.kinetic_energy", 1)[:, 0],
            )
            if plant
            else None
        )

        # The set point of the base is a parameter. Therefore it is constant.
        position, orientation = (
            self.parameter(base, "position_setpoint", 3),
            self.parameter(base, "orientation_setpoint", 4),
        )
        if not 0.5 < np.linalg.norm(orientation) < np.inf:
            self.missing.append(f"a quaternion of norm 1 in parameter {base}.orientation_setpoint")
        setpoint = Motion(
            position=np.tile(position, (self.record.rows, 1)),
            orientation=np.tile(orientation, (self.record.rows, 1)),
            velocity=np.zeros((self.record.rows, 6)),
        )
        self.end_before(~np.isfinite(self.record.time))
        laws = [
            self.law(name, measured, self.parameter(manipulator, energy, 6))
            for name, measured, energy in (
                (manipulator, measured_end_effector, "manipulator_initial_energy"),
                (base, measured_base, "base_initial_energy"),
            )
        ]

        # All signals have been read at this point. Therefore the error message lists all missing
        # data.
        self.check_complete()
        loop = RecordedLoop(
            provenance=self.provenance,
            time=self.record.time,
            base=true_base or measured_base,
            end_effector=true_end_effector or measured_end_effector,
            desired=desired,
            setpoint=setpoint,
            manipulator_law=laws[0],
            base_law=laws[1],
            joint_torque=joint_torque,
            end_effector_wrench=wrenches[0],
            manipulator_passivity_wrench=wrenches[1],
            manipulator_observed_energy=wrenches[2],
            base_observed_energy=wrenches[3],
            base_wrench=wrenches[4],
            port_wrench=wrenches[5],
            base_passivity_wrench=wrenches[6],
            observer=str(self.provenance.parameters[manipulator].get("observer", "unknown")),
            plant=actual,
            rows_left_out=self.record.rows - self.rows,
        )
        cut: RecordedLoop = _first_rows(loop, self.rows)
        return cut

    def component_with(self, outputs: Iterable[str], owner: str) -> str:
        """Return the component that has these outputs, or "" if no component has these outputs.

        Raises RecordError if several components have these outputs.
        """
        components = {component_of(name) for name in self.record.signals}
        found = sorted(
            name
            for name in components
            if all(f"{name}.{output}" in self.record for output in outputs)
        )
        if not found:
            self.missing.append(f"component with the {owner} outputs {', '.join(outputs)}")
            return ""
        if len(found) > 1:
            raise RecordError(
                f"the record of {self.provenance.scenario} has {len(found)} components with the {owner} outputs: {', '.join(found)}; only one component is expected"
            )
        return found[0]

    def plant_component(self) -> str | None:
        """Return the name of the component that simulates the robot, or None.

        This component has the inputs base_wrench and joint_torque, and the output kinetic_energy.
        """
        for name in self.provenance.steps:
            driven = all(
                f"{name}.{entry}" in self.provenance.sources
                for entry in ("base_wrench", "joint_torque")
            )
            if driven and f"{name}.kinetic_energy" in self.record:
                return name
        return None

    def source(self, component: str, entry: str) -> str:
        """Return the output that is connected to the input `entry` of a component.

        If the input has no connection, it is added to `missing`, and the result is "".
        """
        target = f"{component}.{entry}"
        if target not in self.provenance.sources:
            self.missing.append(f"source of {target}")
        return self.provenance.sources.get(target, "")

    def period(self, signal: str) -> int:
        """Return the step [ns] of the component that has the output `signal`."""
        return self.provenance.steps.get(component_of(signal), 1)

    def signal(self, name: str, size: int | None = None) -> Array:
        """Return all rows of a signal (rows, size). If `size` is None, any size is accepted.

        If the signal is missing, it is added to `missing`, and the result is zero. The loop will
        use only the rows before the first row in which the signal is not finite.
        """
        if name not in self.record:
            if name:
                self.missing.append(name)
            return np.zeros((self.record.rows, size or 1))
        values = np.atleast_2d(self.record[name].T).T
        if size is not None and values.shape[1] != size:
            self.missing.append(f"{size} elements of {name}")
        self.end_before(np.asarray(~np.isfinite(values).all(axis=1)))
        return values

    def end_before(self, invalid: NDArray[np.bool_]) -> None:
        """Use only the rows before the first row that is `invalid`."""
        self.rows = min(self.rows, int(np.argmax(invalid)) if invalid.any() else self.record.rows)

    def motion(self, position: str, orientation: str, velocity: str) -> Motion:
        quaternions = self.signal(orientation, 4)
        # A quaternion with a small norm is not a rotation.
        self.end_before(np.asarray(np.linalg.norm(quaternions, axis=1) < 0.5))
        return Motion(
            position=self.signal(position, 3),
            orientation=quaternions,
            velocity=self.signal(velocity, 6),
        )

    def parameter(self, component: str, name: str, size: int) -> Array:
        value: Any = self.provenance.parameters.get(component, {}).get(name)
        plain = isinstance(value, list) and all(
            isinstance(item, int | float) and abs(item) <= sys.float_info.max for item in value
        )
        numbers = np.array(value, dtype=float) if plain else np.zeros(0)
        if numbers.shape != (size,):
            self.missing.append(f"parameter {component}.{name}")
            return np.zeros(size)
        return numbers

    def law(self, component: str, measured: Motion, initial_energy: Array) -> Law:
        return Law(
            period=self.period(component),
            stiffness=self.parameter(component, "stiffness", 6),
            damping=self.parameter(component, "damping", 6),
            initial_energy=initial_energy,
            measured=measured,
            is_plain=self.provenance.parameters.get(component, {}).get("discretisation", "emulated")
            == "emulated",
        )

    def check_complete(self) -> None:
        """Raise RecordError if anything is missing."""
        if self.missing:
            names = ", ".join(dict.fromkeys(self.missing))
            raise RecordError(
                f"the record of {self.provenance.scenario} cannot be audited: it lacks {names}"
            )


def _first_rows(part: Any, rows: int) -> Any:
    """Return a copy of a dataclass in which each signal has only the first `rows` rows.

    Gains and initial energies are not signals. They stay unchanged.
    """
    cut = {}
    for name, value in vars(part).items():
        if isinstance(value, Motion | Plant | Law):
            cut[name] = _first_rows(value, rows)
        elif isinstance(value, np.ndarray) and name not in (
            "stiffness",
            "damping",
            "initial_energy",
        ):
            cut[name] = value[:rows]
        else:
            cut[name] = value
    return type(part)(**cut)
