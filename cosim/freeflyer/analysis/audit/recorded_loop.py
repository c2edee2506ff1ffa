"""The control loop in a record: which signal plays which part, by the connections of the system that it came from."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
"""Outputs that tell the two controllers from other components, whatever their names."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Position (n, 3), orientation (n, 4), velocity (n, 6), in I."""

    position: Array
    orientation: Array
    velocity: Array


@dataclass(frozen=True, kw_only=True)
class Law:
    """A controller: its period [ns], diagonals of K_P and K_D (6 each), E(0) (6), and the motion that it measured.

    `is_plain`: its gains are K_P and K_D, rather than sampled ones that follow from them.
    """

    period: int
    stiffness: Array
    damping: Array
    initial_energy: Array
    measured: Motion
    is_plain: bool


@dataclass(frozen=True, kw_only=True)
class Plant:
    """What really acted on the robot (n, 6) and (n, joints), each new after so many ns, and what came of it: (n, joints) and
    (n) [J].
    """

    base_wrench: Array
    base_wrench_period: int
    joint_torque: Array
    joint_torque_period: int
    joint_position: Array
    kinetic_energy: Array


@dataclass(frozen=True, kw_only=True)
class RecordedLoop:
    """Rows that are finite. Wrenches (n, 6) are those of fmu_src/NOTATION.md; `desired` is the hand's. Without a `plant`, as at
    the facility, base and hand are as they were measured.
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
        """Between two rows [ns]; the last one may be shorter."""
        return round(float(self.time[1] - self.time[0]) * 1e9)


def find(record: Record) -> RecordedLoop:
    """Raises RecordError, with everything that is missing in one sentence."""
    provenance = record.provenance
    if provenance is None:
        raise RecordError("the record does not say which system it came from")
    if provenance.exchange != "sequential":
        raise RecordError(
            f"the record of {provenance.scenario} was made with exchange = {provenance.exchange!r}, where an output belongs to an earlier "
            "sample; an audit needs 'sequential'"
        )
    loop = _Finder(record, provenance).loop()
    if loop.time.size < 2:
        raise RecordError(
            f"the record of {provenance.scenario} has {loop.time.size} finite rows; at least 2 are needed"
        )
    if not (np.diff(loop.time) >= 1e-9).all():
        raise RecordError(
            f"the record of {provenance.scenario} has times that do not increase by a nanosecond from row to row"
        )
    return loop


class _Finder:
    """Collects what is missing, so that it is said at once."""

    def __init__(self, record: Record, provenance: Provenance) -> None:
        self.record, self.provenance = record, provenance
        self.missing: list[str] = []
        self.rows = record.rows

    def loop(self) -> RecordedLoop:
        manipulator, base = (
            self.one_with(MANIPULATOR, "manipulator's"),
            self.one_with(BASE, "base's"),
        )
        self.refuse()
        plant = self.plant_component()
        joint_torque = self.signal(f"{manipulator}.joint_torque")
        joints = joint_torque.shape[1]
        wrenches = [
            self.signal(name, 6)
            for name in [f"{manipulator}.{output}" for output in MANIPULATOR[1:]]
            + [f"{base}.{output}" for output in BASE]
        ]
        measured_base = self.motion(
            self.source(base, "base_position"),
            self.source(manipulator, "base_orientation"),
            self.source(manipulator, "base_velocity"),
        )
        measured_hand = self.motion(
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
        true_base, true_hand = (
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
        place, turn = (
            self.parameter(base, "position_setpoint", 3),
            self.parameter(base, "orientation_setpoint", 4),
        )
        rest = Motion(
            position=np.tile(place, (self.record.rows, 1)),
            orientation=np.tile(turn, (self.record.rows, 1)),
            velocity=np.zeros((self.record.rows, 6)),
        )
        self.end_before(~np.isfinite(self.record.time))
        laws = [
            self.law(name, measured, self.parameter(manipulator, energy, 6))
            for name, measured, energy in (
                (manipulator, measured_hand, "manipulator_initial_energy"),
                (base, measured_base, "base_initial_energy"),
            )
        ]
        self.refuse()
        loop = RecordedLoop(
            provenance=self.provenance,
            time=self.record.time,
            base=true_base or measured_base,
            end_effector=true_hand or measured_hand,
            desired=desired,
            setpoint=rest,
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
            observer=str(self.provenance.parameters[manipulator].get("observer", "not said")),
            plant=actual,
            rows_left_out=self.record.rows - self.rows,
        )
        cut: RecordedLoop = _first_rows(loop, self.rows)
        return cut

    def one_with(self, outputs: Iterable[str], whose: str) -> str:
        """The one component whose outputs these are."""
        components = {component_of(name) for name in self.record.signals}
        found = sorted(
            name
            for name in components
            if all(f"{name}.{output}" in self.record for output in outputs)
        )
        if not found:
            self.missing.append(f"component with the {whose} outputs {', '.join(outputs)}")
            return ""
        if len(found) > 1:
            raise RecordError(
                f"the record of {self.provenance.scenario} has {len(found)} controllers of the {whose} kind: {', '.join(found)}"
            )
        return found[0]

    def plant_component(self) -> str | None:
        """The robot as one body of equations, driven by base wrench and joint torque."""
        for name in self.provenance.steps:
            driven = all(
                f"{name}.{entry}" in self.provenance.sources
                for entry in ("base_wrench", "joint_torque")
            )
            if driven and f"{name}.kinetic_energy" in self.record:
                return name
        return None

    def source(self, component: str, entry: str) -> str:
        """The output that drives an input."""
        target = f"{component}.{entry}"
        if target not in self.provenance.sources:
            self.missing.append(f"source of {target}")
        return self.provenance.sources.get(target, "")

    def period(self, signal: str) -> int:
        """Of the component whose output this is [ns]."""
        return self.provenance.steps.get(component_of(signal), 1)

    def signal(self, name: str, size: int | None = None) -> Array:
        """(rows, size), of any size if it is None, where a scalar is one; what is missing is noted, and the rows end before the
        first that is not finite.
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

    def end_before(self, useless: NDArray[np.bool_]) -> None:
        """The rows that are used end before the first useless one."""
        self.rows = min(self.rows, int(np.argmax(useless)) if useless.any() else self.record.rows)

    def motion(self, position: str, orientation: str, velocity: str) -> Motion:
        turn = self.signal(orientation, 4)
        self.end_before(np.asarray(np.linalg.norm(turn, axis=1) < 0.5))  # not a rotation
        return Motion(
            position=self.signal(position, 3), orientation=turn, velocity=self.signal(velocity, 6)
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

    def refuse(self) -> None:
        if self.missing:
            names = ", ".join(dict.fromkeys(self.missing))
            raise RecordError(
                f"the record of {self.provenance.scenario} cannot be audited: it lacks {names}"
            )


def _first_rows(part: Any, rows: int) -> Any:
    """The same dataclass, every array with rows cut to the first ones."""
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
