"""List, filter and compare the runs in a folder."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

from freeflyer.foundation.errors import RecordError, ScenarioError, one_line
from freeflyer.foundation.file_name import text_of
from freeflyer.foundation.signal_name import split
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.table import Shown, Table
from freeflyer.scenario import run_state, summary_file
from freeflyer.scenario.description import flat, settings
from freeflyer.scenario.overrides import parse_value
from freeflyer.scenario.run_state import OUT

RunState = Literal[
    "completed", "diverged", "failed", "interrupted", "running", "incomplete", "unreadable"
]
"""How a run has ended. "unreadable": its summary.json is damaged, or of another version."""


LONGEST_CELL = 70
"""Longest text about changes in the table."""
ENDS: Sequence[RunState] = ("interrupted", "failed", "diverged")


@dataclass(frozen=True, kw_only=True)
class SavedRun:
    """A run in a directory. `summary` is the content of its summary.json.

    Of a run that has not finished, `summary` has at most the keys `scenario` and `run`.

    `remark` is the reason if the summary cannot be read, or the process that still runs.
    """

    directory: Path
    state: RunState
    summary: Mapping[str, Any]
    remark: str = ""

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return str(self.summary.get("scenario", self.directory.name))

    @property
    def started(self) -> str:
        """Time of the start, in UTC (ISO 8601), or ""."""
        return str(self.summary["run"]["started"]) if self.summary else ""

    @property
    def changes(self) -> Sequence[str]:
        """Changes of the scenario, as arguments of `--set`."""
        return [str(change) for change in self.summary["run"]["changes"]] if self.summary else []

    @cached_property
    def parameters(self) -> Mapping[str, Any]:
        """All parameters of the run [SI]: {"base_controller.period": 0.3, ...}."""
        return flat(self.summary["run"]["parameters"]) if self.summary else {}

    @property
    def numbers(self) -> Mapping[str, Any]:
        """Largest errors [m, deg], least observed energies [J] and the simulated time [s]."""
        found: dict[str, Any] = {}
        for name, value in self.summary.items():
            if isinstance(value, dict) and "_error_" in name:
                found[f"{name}.max"], found[f"{name}.last_10_s"] = value.get("max"), value.get("last_10_s")  # fmt: skip
        for name, energy in self.summary.get("observed_energy_j", {}).items():
            found[f"observed_energy_j.{name}.min"] = energy.get("min")
        return {**found, "simulated_s": self.summary.get("simulated_s")}

    @property
    def as_json(self) -> dict[str, Any]:
        """The content that `freeflyer runs --json` prints."""
        return {
            "directory": str(self.directory),
            "state": self.state,
            "remark": self.remark,
            **({"scenario": self.name, "started": self.started, "changes": self.changes, "cause": self.summary.get("cause"), "numbers": self.numbers} if self.summary else {}),
        }  # fmt: skip


@dataclass(frozen=True, kw_only=True, repr=False)
class Runs(Shown):
    """Runs, the newest first. Iterate over its `SavedRun`s, or show it as a table.

    Errors are in m and deg, energies in J, and times in s.
    """

    folder: str
    found: Sequence[SavedRun]

    def __iter__(self) -> Iterator[SavedRun]:
        return iter(self.found)

    def __len__(self) -> int:
        return len(self.found)

    def __getitem__(self, place: int) -> SavedRun:
        return self.found[place]

    @property
    def table(self) -> Table:
        """Directory, start, end and changes of each run, with its first two largest errors."""
        rows = []
        for run in self.found:
            errors = [value for key, value in run.numbers.items() if key.endswith("_error_m.max")]
            rows.append(
                (
                    str(run.directory),
                    run.started[:19].replace("T", " "),
                    run.state,
                    _shown(run.summary.get("simulated_s")),
                    " ".join(map(_shown, errors[:2])),
                    one_line(run.remark or ", ".join(run.changes), LONGEST_CELL),
                )
            )
        return Table(
            title=f"{len(rows)} run{'s' * (len(rows) != 1)} in {self.folder}",
            header=("run", "started [UTC]", "end", "simulated [s]", "largest position errors [m]", "changes"),
            rows=rows,
        )  # fmt: skip

    @property
    def _readable(self) -> Sequence[SavedRun]:
        return [run for run in self.found if "versions" in run.summary]

    def compare(self) -> Table:
        """Return the parameters that differ, the ends and the numbers, with a column for each run.

        Raises RecordError for less than two readable runs.
        """
        readable = self._readable
        if len(readable) < 2:
            raise RecordError(f"{len(readable)} readable run{'s' * (len(readable) != 1)} in {self.folder}; at least two are needed for a comparison")  # fmt: skip
        sections: list[list[tuple[str, ...]]] = [
            [
                ("started [UTC]", *(run.started[:19].replace("T", " ") for run in readable)),
                ("scenario", *(run.name for run in readable)),
                ("end", *(run.state for run in readable)),
            ],
            _lines([run.parameters for run in readable], only_different=True),
            _lines([settings(run.summary["run"]) for run in readable], only_different=True),
            _lines([run.numbers for run in readable], only_different=False),
            _lines([run.summary["versions"] for run in readable], only_different=True),
        ]
        rows: list[tuple[str, ...]] = []
        breaks = []
        for section in sections:
            breaks.append(len(rows))
            rows += section
        return Table(
            title="Parameters, settings and versions that differ, errors and energies",
            header=("", *(run.directory.name for run in readable)),
            rows=rows,
            breaks=breaks[1:],
        )


def runs(
    folder: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = OUT,
    *,
    scenario: str | None = None,
    end: RunState | None = None,
    where: Mapping[str, Any] | None = None,
) -> Runs:
    """Return the runs in a folder, the newest first. Only their summary.json is read.

    `folder` is a folder that contains the directories of runs, the directory of one run, or a list
    of both. `scenario` selects the runs of one scenario, `end` those that ended so (`SavedRun`).
    `where` selects the runs with these values of parameters, for example a period [s]:
    {"base_controller.period": 0.1}.
    Raises RecordError if a folder does not exist.
    """
    single = isinstance(folder, str | os.PathLike)
    if not single and not isinstance(folder, Sequence):
        raise RecordError(f"the folder of runs is {one_line(repr(folder), 80)}; a path, or a list of paths, is expected")  # fmt: skip
    if where is not None and not (isinstance(where, Mapping) and all(isinstance(key, str) for key in where)):  # fmt: skip
        raise ScenarioError(f"where is {one_line(repr(where), 80)}; a mapping {{'COMPONENT.PARAMETER': value}} is expected")  # fmt: skip
    folders = [folder] if single else list(folder)  # type: ignore[arg-type]
    paths = [Path(text_of(one, "the folder of runs", RecordError)) for one in folders]
    if end is not None and end not in get_args(RunState):
        raise ScenarioError(f"end is {end!r}; one of {', '.join(get_args(RunState))} is expected{did_you_mean(str(end), get_args(RunState))}")  # fmt: skip
    unique = {directory.resolve(): directory for path in paths for directory in _directories(path)}
    found = sorted(map(saved_run, unique.values()), key=lambda run: (run.started, str(run.directory)), reverse=True)  # fmt: skip
    if not single:  # runs that the caller names keep their order
        order = {path: place for place, path in enumerate(unique.values())}
        found.sort(key=lambda run: order[run.directory])
    _check_filters(found, scenario, where or {})
    found = [
        run
        for run in found
        if scenario in (None, run.name)
        and end in (None, run.state)
        and all(_equal(run, target, value) for target, value in (where or {}).items())
    ]
    return Runs(folder=", ".join(map(str, paths)), found=found)


def _check_filters(
    found: Sequence[SavedRun], scenario: str | None, where: Mapping[str, Any]
) -> None:
    """Raise ScenarioError for a scenario or a parameter that no run has."""
    names = {run.name for run in found}
    if found and scenario is not None and scenario not in names:
        raise ScenarioError(
            f"no run has the scenario {scenario!r}{did_you_mean(scenario, sorted(names))}"
        )
    known = {target for run in found for target in run.parameters}
    for target in where:
        if known and target not in known:
            raise ScenarioError(
                f"no run has the parameter {target!r}{did_you_mean(target, sorted(known))}"
            )


def _directories(folder: Path) -> Iterator[Path]:
    """Yield the directories of runs in a folder, without links. A run itself is yielded."""
    try:
        if run_state.is_run(folder):
            yield folder
            return
        with os.scandir(folder) as entries:
            paths = [folder / entry.name for entry in entries if entry.is_dir(follow_symlinks=False)]  # fmt: skip
    except FileNotFoundError as error:
        raise RecordError(f"there is no folder {folder}; a folder with runs is expected, which `freeflyer run` makes") from error  # fmt: skip
    except OSError as error:
        raise RecordError(f"folder {folder} cannot be read: {error.strerror}; a folder with runs is expected") from error  # fmt: skip
    yield from filter(run_state.is_run, sorted(paths))


def saved_run(directory: Path) -> SavedRun:
    """Return a run from its directory. A damaged run is returned with the reason."""
    if not (directory / run_state.SUMMARY).exists():
        user = run_state.owner(directory)
        state: RunState = "incomplete" if user is None else "running"
        remark = user or "`freeflyer recover` completes it"
        if run_state.state(directory) == "finished":
            state, remark = "failed", _reason_of_stop(directory)
        return SavedRun(directory=directory, state=state, summary=summary_file.begun(directory), remark=remark)  # fmt: skip
    try:
        summary = summary_file.read(directory)
        state = next((key for key in ENDS if summary[key]), "completed")
        run = SavedRun(directory=directory, state=state, summary=summary)
        _ = run.numbers, run.as_json
    except (RecordError, LookupError, TypeError, AttributeError) as error:
        return SavedRun(directory=directory, state="unreadable", summary={}, remark=one_line(error))
    return run


def _reason_of_stop(directory: Path) -> str:
    """Return the reason of the stop of devices, if their run has no summary.json."""
    try:
        content = (directory / run_state.STOP).read_text(encoding="utf-8")
        return str(json.loads(content)["reason"] or "the process died; its recordings are restored")
    except (OSError, ValueError, LookupError, TypeError):
        return "stop.json cannot be read"


def _equal(run: SavedRun, target: str, value: Any) -> bool:
    """Return whether a parameter of a run has a value. Raises ScenarioError for a bad target."""
    if not all(split(target)):
        raise ScenarioError(f"{target!r} is not COMPONENT.PARAMETER")
    wanted = parse_value(value) if isinstance(value, str) else value
    if isinstance(wanted, Mapping):
        raise ScenarioError(f"{target}={value}: a value without a unit is expected here, as `freeflyer runs` shows it")  # fmt: skip
    return bool(run.parameters.get(target) == wanted)


def _lines(values: Sequence[Mapping[str, Any]], *, only_different: bool) -> list[tuple[str, ...]]:
    keys = dict.fromkeys(key for one in values for key in one)
    return [
        (key, *(_shown(one.get(key)) for one in values))
        for key in keys
        if not only_different or any(one.get(key) != values[0].get(key) for one in values)
    ]


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    return "-" if value is None else one_line(str(value), LONGEST_CELL)
