"""Show a run, two runs, a scenario or a robot in one HTML file."""

from __future__ import annotations

import html
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from freeflyer.fmi.fmu_description import ports_in
from freeflyer.foundation import toml_file
from freeflyer.foundation.errors import (
    CosimError,
    OutputError,
    RecordError,
    UnusableOutput,
    one_line,
)
from freeflyer.foundation.file_name import text_of
from freeflyer.foundation.output_file import write_text
from freeflyer.foundation.plugins import load, plugins
from freeflyer.master.record import Record, Signal
from freeflyer.scenario import metrics, run_state, scenario
from freeflyer.scenario.experiment import Result, run
from freeflyer.scenario.saved_run import open_run
from freeflyer.viewer import scene as scenes
from freeflyer.viewer.content import Run, content, matching
from freeflyer.viewer.page import page

GROUP = "freeflyer.view_readers"
"""Group of the entry points for files to view. The name is the suffix of the file, without a dot.

The callable is called with the path and a mapping of options, which is empty. It returns a mapping:
either `scene` and `posture` (the geometry of a robot, and its joint positions), or `record`,
`title`, `end`, `cause`, `notes` and `marks`.
"""
Scene = scenes.Scene
LONGEST_LABEL = 60
"""Longest label of a run [characters]."""


@dataclass(frozen=True, kw_only=True)
class View:
    """A page that shows runs. `text` is the HTML file; it needs no other file and no network.

    Its values are in SI units; plots have the units of the record. `notes` are sentences about what
    cannot be shown. `directory` is the default directory of the file: that of the run, or the
    working directory. A notebook shows the page.
    """

    text: str
    title: str
    notes: Sequence[str]
    directory: Path

    def write(self, path: str | os.PathLike[str] | None = None) -> Path:
        """Write the file, and return its path. By default, it is view.html in `directory`.

        Raises OutputError if the file cannot be written, or if its name does not end in .html.
        """
        target = self.directory / "view.html" if path is None else Path(text_of(path, "the file"))
        if target.suffix.lower() != ".html" or target.is_dir():
            raise UnusableOutput(f"{path!s:.200} is not a file name that ends in .html")
        try:
            write_text(target, self.text)
        except OutputError as error:
            raise UnusableOutput(str(error)) from error
        return target

    def _repr_html_(self) -> str:
        return f'<iframe srcdoc="{html.escape(self.text)}" style="width:100%;height:640px;border:0"></iframe>'

    def __repr__(self) -> str:
        return f"View of {self.title}: `write()` writes the HTML file"


@dataclass(frozen=True, kw_only=True)
class _Shown:
    """One source with its geometry. `directory` is where the page is written by default."""

    run: Run
    scene: Scene | None
    notes: Sequence[str]
    directory: Path


def view(
    *sources: Result | str | os.PathLike[str],
    signals: Sequence[str] = (),
    robot: str | os.PathLike[str] | None = None,
) -> View:
    """Return a page that shows one run, or two runs side by side.

    A source is a result of `run`, the directory of a run, a scenario, a recording (.mcap), an FMU,
    or a robot (.urdf). A scenario is shown at its start, a robot in its start posture. `signals`
    are patterns of further signals to plot, each in its own unit, for example
    "free_flyer.joint_velocity". `robot` is a file with the geometry (.urdf or .fmu) for a record
    without one. Raises CosimError.
    """
    if not 1 <= len(sources) <= 2:
        raise CosimError(f"{len(sources)} sources are given; one run, or two runs to compare, are expected")  # fmt: skip
    other = None if robot is None else _scene_of_file(Path(text_of(robot, "the robot")))[0]
    shown = [_source(source) for source in sources]
    for pattern in signals:
        if not any(matching(one.run.record, [pattern]) for one in shown):
            raise RecordError(f"no recorded signal matches {pattern!r}")
    labels = _labels([one.run for one in shown])
    contents = []
    for one, label in zip(shown, labels, strict=True):
        scene = other if other is not None else one.scene
        made = content(replace(one.run, label=label), scene, signals)
        made["notes"] += one.notes if scene is None or other is None else []
        made["notes"] += scene.get("notes", []) if scene is not None else []
        contents.append(made)
    title = " and ".join(labels)
    notes = [note for made in contents for note in made["notes"]]
    return View(text=page(title, contents), title=title, notes=notes, directory=shown[0].directory)


def _labels(runs: Sequence[Run]) -> list[str]:
    """Return different names for the runs: with their changes, or with numbers if necessary."""
    names = [run.label for run in runs]
    if len(set(names)) < len(names):
        changes = [", ".join(run.scenario.changes) if run.scenario else "" for run in runs]
        names = [one_line(f"{name} ({text})" if text else name, LONGEST_LABEL) for name, text in zip(names, changes, strict=True)]  # fmt: skip
    if len(set(names)) < len(names):
        names = [f"{name} ({i + 1})" for i, name in enumerate(names)]
    return names


def _source(source: Result | str | os.PathLike[str]) -> _Shown:
    if isinstance(source, Result):
        return _of_result(source, source.scenario.name, Path())
    text = text_of(source, "the run to view", CosimError)
    path = Path(text)
    if run_state.is_run(path):
        saved = open_run(path)
        return _of_result(saved, saved.scenario.name, path)
    suffix = path.suffix.lower().removeprefix(".")
    if suffix == "" or (suffix == "toml" and not _is_robot(path)):
        # Simulate one short step, for the values at the start.
        start = run(scenario.load(text), ["stop_s=0.001"])
        found = _of_result(start, start.scenario.name, Path())
        return replace(found, run=replace(found.run, end="completed", cause=None, title=f"{found.run.title} (at the start)"))  # fmt: skip
    if suffix in plugins(GROUP) or suffix == "fmu":
        return _of_file(path)
    raise CosimError(f"{text} cannot be viewed; the directory of a run, a scenario, or a file with the suffix {', '.join(sorted(['fmu', *plugins(GROUP)]))} is expected")  # fmt: skip


def _is_robot(path: Path) -> bool:
    """Return whether a TOML file describes a robot. All other files are scenarios."""
    try:
        return "urdf" in toml_file.read(path)
    except (OSError, ValueError):
        return False  # the reader of scenarios reports the error


def _of_result(result: Result, label: str, directory: Path) -> _Shown:
    record = result.record
    parameters = record.provenance.parameters if record.provenance else {}
    scene, notes = scenes.of_scenario(result.scenario, parameters, result.summary["run"]["tokens"])
    shown = Run(
        record=record,
        ended=result.outcome.simulated,
        scenario=result.scenario,
        label=label,
        title=result.scenario.title,
        errors=result.errors,
        end=result.verdict,
        cause=result.outcome.cause,
    )
    return _Shown(run=shown, scene=scene, notes=notes, directory=directory)


def _scene_of_file(path: Path) -> tuple[Scene, list[float] | None]:
    """Return the geometry in a file, and the joint positions at the start. Raises CosimError."""
    suffix = path.suffix.lower().removeprefix(".")
    if suffix == "fmu":
        try:
            scene = scenes.of_fmu(path)
            ports = ports_in(path)[0]
        except OSError as error:
            raise CosimError(f"{path} cannot be read: {error.strerror or error}") from error
        if scene is None:
            raise CosimError(f"{path} contains no geometry; the FMU of a plant of this project is expected")  # fmt: skip
        port = ports.get("joint_position")
        start = None if port is None or port.start is None else list(port.start)
        return scene, start
    found = _read(path)
    if "scene" not in found:
        raise CosimError(f"{path} contains no robot; a .urdf or .fmu file is expected")
    return scenes.checked(found["scene"], str(path)), found.get("posture")


def _read(path: Path) -> Mapping[str, Any]:
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in plugins(GROUP):
        raise CosimError(f"{path} cannot be viewed: there is no reader for the suffix {path.suffix!r}")  # fmt: skip
    reader: Callable[[Path, Mapping[str, Any]], Mapping[str, Any]] = load(plugins(GROUP)[suffix])
    try:
        return reader(path, {})
    except OSError as error:
        raise CosimError(f"{path} cannot be read: {error.strerror or one_line(error)}") from error


def _of_file(path: Path) -> _Shown:
    """Return a recording, or a robot at rest."""
    found = {} if path.suffix.lower() == ".fmu" else _read(path)
    if "record" in found:
        return _of_recording(path, found)
    scene, posture = _scene_of_file(path)
    record = _at_rest(posture or [0.0] * len(scene["joints"]))
    shown = Run(record=record, scenario=None, label=path.stem, title=f"Robot {scene['name']}", errors={}, end="completed", cause=None)  # fmt: skip
    return _Shown(run=shown, scene=scene, notes=[], directory=Path())


def _of_recording(path: Path, found: Mapping[str, Any]) -> _Shown:
    """Return a recording. Its scenario and geometry are those of the run in its directory."""
    record: Record = found["record"]
    chosen, scene, errors = None, None, {}
    try:
        saved = open_run(path.parent)
        chosen, record.provenance = saved.scenario, saved.record.provenance
        parameters = record.provenance.parameters if record.provenance else {}
        scene, notes = scenes.of_scenario(chosen, parameters)
        errors = metrics.errors(chosen, record)
    except (CosimError, LookupError) as error:
        notes = [f"the recording is shown without errors and geometry: {one_line(error)}"]
    shown = Run(
        record=record,
        scenario=chosen,
        label=path.stem,
        title=found["title"],
        errors=errors,
        end=found["end"],
        cause=found["cause"],
        marks=found["marks"],
    )
    return _Shown(run=shown, scene=scene, notes=[*notes, *found["notes"]], directory=path.parent)


def _at_rest(posture: Sequence[float]) -> Record:
    """Return a record of one row: the base at the origin, and the joints in a posture."""
    values = {
        "base_position": [0.0, 0.0, 0.0],
        "base_orientation": [0.0, 0.0, 0.0, 1.0],
        "joint_position": list(posture),
    }
    signals, first = [], 0
    for name, value in values.items():
        size = len(value)
        signals.append(Signal(name=f"robot.{name}", first=first, size=size, units=(None,) * size))
        first += size
    record = Record(signals, 1)
    record.append(0.0, np.concatenate([np.asarray(value) for value in values.values()]))
    return record
