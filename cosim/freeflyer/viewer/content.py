"""Content of the page for one run: poses, wrenches, plots and marks.

The signals are found by `[errors]` and `[roles]` of the scenario, by the connections in the
provenance of the record, and by the names of the variables of the shipped blocks.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from freeflyer.fmi.component import Array
from freeflyer.foundation.signal_name import split
from freeflyer.master.record import Record
from freeflyer.scenario.metrics import signal_or_parameter
from freeflyer.scenario.scenario import Scenario
from freeflyer.viewer import kinematics
from freeflyer.viewer.series import encoded, reduced

LENGTH, ANGLE = 1e-10, 1e-10
"""Resolution of positions [m], and of angles [rad] and quaternions."""
RELATIVE = 1e-4
"""Resolution of all other values, relative to the range of the series."""
MOST_POSES, MOST_SAMPLES, MOST_MARKS = 40_000, 10_002, 3_000
"""Largest numbers of poses, of samples of a plotted element, and of marks of one kind."""
SAME_ROBOT = 0.02
"""Distance [m] between drawn and recorded end-effector above which a note is given.

The record of a real robot has measurement errors.
"""
MOST_ELEMENTS = 60
"""Largest number of plotted elements."""
AXES = ("x", "y", "z", "about x", "about y", "about z")
WRENCHES = {
    "port B": ("base", "base_wrench", False),
    "port M": ("end_effector", "end_effector_wrench", False),
    "passivity controller at port B": ("base", "passivity_wrench", True),
    "passivity controller at port M": ("end_effector", "passivity_wrench", True),
}
"""Names of wrenches: the body on which it acts, the variable, whether it is of a passivity
controller."""
PLOTTED = ("kinetic_energy", "joint_limit_margin", "joint_torque")
"""Variables that are plotted if they are recorded, beside errors, energies and PC wrenches."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run to show. `errors` are its time series by name, as in `Result.errors`.

    `end` is how the run ended, `cause` its reason or None. `marks` are further marks on the time
    axis, for example faults.
    """

    record: Record
    scenario: Scenario | None
    label: str
    title: str
    errors: Mapping[str, Array]
    end: str
    cause: str | None
    marks: Sequence[Mapping[str, Any]] = ()
    ended: float | None = None
    """Simulated time [s] at the end. None: that of the last row."""


def content(run: Run, scene: Mapping[str, Any] | None, patterns: Sequence[str]) -> dict[str, Any]:
    """Return the content of the page for a run, as JSON types.

    `scene` is the geometry of the robot, or None. `patterns` select further signals to plot.
    """
    finder = _Finder(run.record, run.scenario)
    time = run.record.time
    rows = np.unique(np.linspace(0, time.size - 1, min(time.size, MOST_POSES)).astype(int))

    def columns(values: Array | None, quantum: float | None = None) -> list[Any] | None:
        if values is None:
            return None
        taken = np.atleast_2d(values.T).T[rows]
        return [
            encoded(column, _quantum(column) if quantum is None else quantum) for column in taken.T
        ]

    def pose(position: Array | None, orientation: Array | None) -> dict[str, Any] | None:
        if position is None or orientation is None:
            return None
        return {
            "position": columns(position, LENGTH),
            "orientation": columns(_continuous(orientation), ANGLE),
        }

    if rows.size < time.size:
        finder.notes.append(f"the picture has {rows.size} of {time.size} poses; the plots keep all extremes")  # fmt: skip
    set_point = finder.set_point()
    joints = finder.joints()
    if scene is not None and joints is not None and joints.shape[1] != len(scene["joints"]):
        joints = scene = None
        finder.notes.append("the geometry has another number of joints than the record; the robot is not drawn")  # fmt: skip
    return {
        "label": run.label,
        "title": run.title,
        "end": {"kind": run.end, "time": _end_time(run), "cause": run.cause},
        "scene": scene,
        "time": encoded(time[rows], 1e-9),
        "base": pose(finder.pose("base_position"), finder.pose("base_orientation")),
        "joints": columns(joints, ANGLE),
        "desired": pose(
            finder.desired("end_effector_position"), finder.desired("end_effector_orientation")
        ),
        "set_point": set_point,
        "wrenches": [
            {
                "name": name,
                "at": WRENCHES[name][0],
                "passivity": WRENCHES[name][2],
                "force": columns(wrench[:, :3]),
                "torque": columns(wrench[:, 3:]),
            }
            for name, wrench in finder.wrenches()
        ],
        "plots": list(_plots(run, finder, patterns)),
        "marks": [*_samples(finder), *_active(finder, time), *run.marks, *_end(run, time)],
        "center_of_mass": columns(_centre_of_mass(finder, scene, joints), LENGTH),
        "momentum": None
        if (linear := finder.variable("linear_momentum")) is None
        or (angular := finder.variable("angular_momentum")) is None
        else {"linear": columns(linear), "angular": columns(angular)},
        "joint_margin": None
        if (margin := finder.variable("joint_limit_margin")) is None
        else (columns(margin.reshape(time.size, -1).min(axis=1)) or [None])[0],
        "notes": finder.notes,
    }


class _Finder:
    """Reader of the signals of a run by their meaning."""

    def __init__(self, record: Record, scenario: Scenario | None) -> None:
        self.record, self.scenario, self.notes = record, scenario, list[str]()
        self.measures = scenario.errors if scenario is not None else {}

    def named(self, signal: str) -> Array | None:
        """Return the values (rows, size) of a recorded signal or a parameter, or None."""
        try:
            return signal_or_parameter(signal, self.record)
        except LookupError:
            return None

    def variable(self, name: str) -> Array | None:
        """Return the first recorded signal whose variable has this name."""
        signal = next((s for s in self.record if split(s)[1] == name), None)
        return None if signal is None else self.named(signal)

    def pose(self, name: str) -> Array | None:
        """Return a measured position or orientation, for example "base_position"."""
        if name in self.measures:
            return self.named(self.measures[name].actual)
        declared = self.scenario.roles.declared.get(name, ()) if self.scenario else ()
        return self.named(declared[0]) if declared else self.variable(name)

    def desired(self, name: str) -> Array | None:
        if name in self.measures:
            return self.named(self.measures[name].desired)
        return self.variable({"end_effector_position": "position", "end_effector_orientation": "orientation"}[name])  # fmt: skip

    def set_point(self) -> dict[str, Any] | None:
        """Return the desired pose of the base, if it is constant."""
        found = [
            self.named(self.measures[name].desired) if name in self.measures else None
            for name in ("base_position", "base_orientation")
        ]
        if any(values is None or np.ptp(values, axis=0).max(initial=0.0) != 0.0 for values in found):  # fmt: skip
            return None
        position, orientation = (values[0].tolist() for values in found if values is not None)
        return {"position": position, "orientation": orientation}

    def joints(self) -> Array | None:
        """Return the joint positions (rows, joints): the source of an input, or a signal."""
        provenance = self.record.provenance
        sources = provenance.sources.items() if provenance else ()
        signal = next(
            (
                s
                for target, s in sources
                if split(target)[1] == "joint_position" and s in self.record
            ),
            None,
        )
        return self.variable("joint_position") if signal is None else self.named(signal)

    def controllers(self) -> tuple[str | None, str | None]:
        """Return the components that control the base and the manipulator."""
        found = [
            next((split(s)[0] for s in self.record if split(s)[1] == name), None)
            for name in ("port_wrench", "end_effector_wrench")
        ]
        return found[0], found[1]

    def wrenches(self) -> Iterator[tuple[str, Array]]:
        base, manipulator = self.controllers()
        for name, (at, variable, _) in WRENCHES.items():
            owner = base if at == "base" else manipulator
            values = None if owner is None else self.named(f"{owner}.{variable}")
            if values is not None and values.shape[1] == 6:
                yield name, values


def _centre_of_mass(
    finder: _Finder, scene: Mapping[str, Any] | None, joints: Array | None
) -> Array | None:
    """Return the centre of mass (rows, 3) [m]. Also compare the scene with the record."""
    position, orientation = finder.pose("base_position"), finder.pose("base_orientation")
    if scene is None or joints is None or position is None or orientation is None:
        return None
    known = np.linalg.norm(orientation, axis=1) > 0.0
    poses = kinematics.frames(scene, position, np.where(known[:, None], orientation, [0, 0, 0, 1.0]), joints)  # fmt: skip
    end_effector = finder.pose("end_effector_position")
    if end_effector is not None:
        gaps = np.linalg.norm(poses[-1][1] - end_effector, axis=1)
        gap = float(np.nanmax(gaps, initial=0.0))
        if gap > SAME_ROBOT:
            finder.notes.append(f"the geometry may be that of another robot: its end-effector is up to {gap:.3g} m from the recorded one")  # fmt: skip
    return kinematics.centre_of_mass(scene, poses)


def _continuous(orientation: Array) -> Array:
    """Return quaternions (n, 4) without jumps between q and -q."""
    products = np.sum(orientation[1:] * orientation[:-1], axis=1)
    signs = np.cumprod(np.concatenate([[1.0], np.where(products < 0.0, -1.0, 1.0)]))
    return orientation * signs[:, None]


def _quantum(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return max(float(np.ptp(finite)) * RELATIVE, 1e-300) if finite.size else 1.0


def _plots(run: Run, finder: _Finder, patterns: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield the plots: errors, energies, what the passivity controllers add, and signals."""
    time, left = run.record.time, MOST_ELEMENTS

    def plot(title: str, unit: str, lines: Mapping[str, Array]) -> dict[str, Any]:
        signals = []
        for label, values in lines.items():
            moments, kept = reduced(time, values, MOST_SAMPLES)
            signals.append(
                {
                    "label": label,
                    "time": encoded(moments, 1e-9) if moments.size != time.size else "all",
                    "value": encoded(kept, _quantum(kept)),
                }
            )
        return {"title": title, "unit": unit, "signals": signals}

    whole = encoded(time, 1e-9) if time.size <= MOST_SAMPLES else None
    chosen: list[tuple[str, str, dict[str, Array]]] = []
    for unit, title in (("m", "position error"), ("deg", "orientation error")):
        lines = {
            name.rpartition("_error_")[0]
            .removesuffix(f"_{title.split()[0]}")
            .replace("_", "-"): values
            for name, values in run.errors.items()
            if name.endswith(f"_error_{unit}")
        }
        if lines:
            chosen.append((title, unit, lines))
    for name, signal in (run.scenario.observed_energy if run.scenario else {}).items():
        values = finder.named(signal)
        if values is not None:
            chosen.append(
                (f"observed energy, {name}", "J", dict(zip(AXES, values.T, strict=False)))
            )
    norms = {
        quantity: {
            name.rpartition(" at ")[2]: np.linalg.norm(wrench[:, part], axis=1)
            for name, wrench in finder.wrenches()
            if WRENCHES[name][2]
        }
        for quantity, part in (("force", slice(0, 3)), ("torque", slice(3, 6)))
    }
    for (quantity, lines), unit in zip(norms.items(), ("N", "N m"), strict=True):
        if lines:
            chosen.append((f"{quantity} of the passivity controllers", unit, lines))
    signals = [s for s in run.record if split(s)[1] in PLOTTED]
    signals += [s for s in matching(run.record, patterns) if s not in signals]
    for signal in signals:
        values = run.record[signal].reshape(time.size, -1)
        columns = run.record.signals[signal].columns
        labels = ["value"] if len(columns) == 1 else [str(i + 1) for i in range(len(columns))]
        unit = run.record.units[columns[0]]
        chosen.append((signal, unit, dict(zip(labels, values.T, strict=True))))
    for title, unit, lines in chosen:
        if left <= 0:
            run_notes = f"{MOST_ELEMENTS} elements are plotted; further signals are left out"
            if run_notes not in finder.notes:
                finder.notes.append(run_notes)
            return
        left -= len(lines)
        made = plot(title, unit, lines)
        for line in made["signals"]:
            line["time"] = whole if line["time"] == "all" else line["time"]
        yield made


def matching(record: Record, patterns: Sequence[str]) -> list[str]:
    """Return the signals of a record that match a pattern with wildcards, in the given order."""
    return [signal for pattern in patterns for signal in fnmatch.filter(list(record), pattern)]


def _samples(finder: _Finder) -> Iterator[dict[str, Any]]:
    """Yield a mark for each sample of the base's controller."""
    base, _ = finder.controllers()
    provenance, time = finder.record.provenance, finder.record.time
    if base is None or provenance is None or base not in provenance.steps or not time.size:
        return
    period = provenance.steps[base] * 1e-9
    count = int(time[-1] / period + 1e-9) + 1
    if count > MOST_MARKS:
        finder.notes.append(f"the base is sampled every {period:g} s; {count} marks are not shown")
        return
    for k in range(count):
        yield {"kind": "base sample", "time": k * period, "until": None, "text": f"sample {k} of the base's controller"}  # fmt: skip


def _active(finder: _Finder, time: Array) -> Iterator[dict[str, Any]]:
    """Yield a mark for each interval in which a passivity controller is active."""
    for name, wrench in finder.wrenches():
        if not WRENCHES[name][2]:
            continue
        active = np.any(wrench != 0.0, axis=1)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], active, [False]]).astype(int)))
        for first, last in list(zip(edges[::2], edges[1::2], strict=True))[:MOST_MARKS]:
            yield {
                "kind": "passivity control",
                "time": float(time[first]),
                "until": float(time[min(last, time.size - 1)]),
                "text": f"{name} is active",
            }


def _end_time(run: Run) -> float:
    last = float(run.record.time[-1]) if run.record.rows else 0.0
    return last if run.ended is None else run.ended


def _end(run: Run, time: Array) -> Iterator[dict[str, Any]]:
    if run.end != "completed" and time.size:
        yield {"kind": "stop", "time": _end_time(run), "until": None, "text": run.cause or run.end}
