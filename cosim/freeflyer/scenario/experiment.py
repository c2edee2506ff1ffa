"""Run one scenario, and its results."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from freeflyer.fmi.component import Array, Port
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import CosimError, OutputError
from freeflyer.foundation.file_name import text_of
from freeflyer.foundation.interrupts import interrupts
from freeflyer.foundation.table import Shown, Table
from freeflyer.master import native
from freeflyer.master.master import Master, Outcome
from freeflyer.master.master import Progress as Report
from freeflyer.master.provenance import Provenance
from freeflyer.master.record import Record
from freeflyer.scenario import metrics
from freeflyer.scenario.assemble import assembled
from freeflyer.scenario.description import described, differences
from freeflyer.scenario.overrides import Changes
from freeflyer.scenario.parameters import Values, current
from freeflyer.scenario.run_directory import Existing, RunDirectory
from freeflyer.scenario.run_state import RECORD
from freeflyer.scenario.scenario import Scenario, loaded
from freeflyer.scenario.summary_file import sealed
from freeflyer.scenario.verdict import End, as_expected, end_of, sentence

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True, repr=False)
class Result(Shown):
    """Results of a run.

    `errors` maps the name of an error in summary.json to its time series (rows) [m or deg, as in
    the name]. A time series has one value for each row of the record. `summary` is the content of
    summary.json.
    """

    scenario: Scenario
    outcome: Outcome
    errors: Mapping[str, Array]
    summary: Mapping[str, Any]

    @property
    def as_expected(self) -> bool:
        """Whether the run ended in the way that the scenario expects: completed or diverged."""
        return as_expected(self.scenario, self.outcome)

    @property
    def record(self) -> Record:
        """Times and signals: `record.time`, `record["free_flyer.base_position"]`."""
        return self.outcome.record

    @property
    def verdict(self) -> End:
        """How the run ended. `outcome.cause` is the reason of an early end."""
        return end_of(self.outcome)

    def plot(self, *others: Result, labels: Sequence[str] | None = None) -> Figure:
        """Return a figure of all errors over time, together with those of `others`.

        `labels` are the names of the runs in the legend (default: the names of the scenarios).
        Save the figure with its method `savefig`. Raises CosimError if there is nothing to plot.
        """
        from freeflyer.scenario import plot

        runs = (self, *others)
        for run in others:
            if not isinstance(run, Result):
                raise CosimError(
                    f"plot: {type(run).__name__} {run!r:.40}; results of `run` are expected"
                )
        return plot.errors(
            [(run.record.time, run.errors) for run in runs],
            labels or [run.scenario.name for run in runs],
        )

    def view(self, *others: Result, signals: Sequence[str] = ()) -> Any:
        """Return a `View` of this run, or of this run beside another, in 3D with plots.

        A notebook shows it; its method `write` writes it as one HTML file. `signals` are
        patterns of further signals to plot, each in its unit. Raises CosimError.
        """
        # The package `view` uses this module.
        return import_module("freeflyer.viewer.view").view(self, *others, signals=signals)

    def save(
        self, directory: str | os.PathLike[str] | None = None, existing: Existing | None = None
    ) -> Path:
        """Write record.parquet and summary.json to a directory of their own, and return its path.

        Without `directory`, it is freeflyer_out/NAME-TIME-HASH, and freeflyer_out/NAME links to it.
        A finished run in `directory` is renamed (DIR.1), and any other content is an error, unless
        `existing` is "keep" (rename it) or "overwrite" (replace the results). Raises OutputError.
        """
        claimed = claim(self.scenario, directory, existing)
        with claimed:
            claimed.begin()
            try:
                self.finish(claimed)
            except OutputError:
                (claimed.path / RECORD).unlink(missing_ok=True)
                raise
        return claimed.path

    def finish(self, directory: RunDirectory) -> None:
        """Write record.parquet and summary.json to a directory that has been claimed.

        Raises OutputError. The run then stays incomplete.
        """
        with interrupts():  # after Ctrl-C during the first file, the second file is still written
            directory.finish({RECORD: self.record.write_file}, sealed(self.summary))

    def differences(self, other: Result) -> list[str]:
        """Return what differs between this run and another, in sentences.

        The list is empty if their records have the same bits.
        """
        return differences(self.summary, other.summary, (self.record, other.record))

    @property
    def table(self) -> Table:
        """Largest errors, smallest observed energies and times, as `freeflyer run` prints them."""
        rows = []
        for name in self.errors:
            label, _, unit = name.rpartition("_error_")
            values = self.summary[name]
            rows.append(
                (
                    f"{label.replace('_', ' ')} error [{unit}]",
                    _shown(values["max"]),
                    _shown(values["last_10_s"]),
                )
            )
        rows += [
            (f"{name} observed energy, minimum [J]", _shown(energy["min"]), "")
            for name, energy in self.summary["observed_energy_j"].items()
        ]
        times = f"{self.outcome.simulated:g}", f"{self.outcome.wall:.2f}"
        return Table(
            title=self.scenario.title,
            header=("", "maximum", "last 10 s"),
            rows=[*rows, ("simulated [s] / wall [s]", *times)],
        )

    def __repr__(self) -> str:
        end = sentence(self.scenario, self.outcome) or "completed"
        return f"{super().__repr__()}\n{end}"

    def _repr_html_(self) -> str:
        end = sentence(self.scenario, self.outcome) or "completed"
        return f"{super()._repr_html_()}<p>{escape(end)}</p>"


def _shown(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.3g}"


Engine = Literal["core", "python"]
"""The implementation that steps the components during a run.

"core" is the C code (`freeflyer.master.native`). "python" is `Master.run`, which uses FMPy.
Both engines give the same numbers.
"""


def run(
    scenario: Scenario | str | os.PathLike[str],
    changes: Changes = (),
    *,
    fmi: int | None = None,
    progress: Report | None = None,
    engine: Engine = "core",
    directory: RunDirectory | str | os.PathLike[str] | None = None,
    existing: Existing | None = None,
) -> Result:
    """Check and simulate a scenario, and compute its errors and summary.

    `scenario` is a result of `load`, or its argument. `changes` are those of `load`. `fmi`, if
    given, overrides the FMI version of all FMUs. `engine` is the code that steps them (`Engine`).
    `progress` is called with the simulated time [s] during the run. `directory`, if given, has the
    rows during the run, and the results afterwards; for `existing`, see `Result.save`. Several
    threads may run scenarios. After Ctrl-C, the result has the rows up to then, with the verdict
    "interrupted". Raises CosimError for an error before the first step. An error in a step ends the
    run without an exception. It is then in `outcome` of the result.
    """
    scenario = loaded(scenario, changes)
    if engine not in get_args(Engine):
        raise CosimError(
            f"engine is {engine!r}; {' or '.join(map(repr, get_args(Engine)))} is expected"
        )
    if not (progress is None or callable(progress)):
        raise CosimError(f"progress is {progress!r}; a function of the simulated time is expected")
    if directory is not None and not isinstance(directory, RunDirectory):
        directory = claim(scenario, directory, existing)
    rows, undone = (None, nullcontext()) if directory is None else (directory.rows, directory)
    # If Ctrl-C ends the simulation, the results up to then are kept, summarised and written.
    with interrupts():
        with undone, assembled(scenario, fmi, rows) as (master, values):
            metrics.check(scenario, master.graph.components)
            origin = provenance(scenario, master, values)
            about = described(scenario, master.graph.components, origin, fmi=fmi, engine=engine)
            if directory is not None:
                directory.begin()
                directory.describe({"run": about, "provenance": asdict(origin)})
            outcome = native.run(master, progress) if engine == "core" else master.run(progress)
            if progress is not None:
                progress(outcome.simulated)
        outcome.record.provenance = replace(origin, sampled_at_end=master.sampled_at_end)
        result = result_of(scenario, outcome, about)
        if directory is not None:
            result.finish(directory)
    return result


def result_of(
    scenario: Scenario, outcome: Outcome, about: Mapping[str, Any], **more: Any
) -> Result:
    """Return the result of a run that has ended. `about` is its description.

    The record must have its provenance. `more` are further members of summary.json.
    """
    series = metrics.errors(scenario, outcome.record)
    run = {**about, "record_sha256": outcome.record.digest}
    summary = {**metrics.summary(scenario, outcome, series), **more, "run": run}
    return Result(scenario=scenario, outcome=outcome, errors=series, summary=summary)


def claim(
    scenario: Scenario,
    directory: str | os.PathLike[str] | None,
    existing: Existing | None,
    label: str | None = None,
) -> RunDirectory:
    """Claim a directory for a run. Raises OutputError if it is in use, or has other content.

    Without `directory`, the directory is freeflyer_out/LABEL-TIME-HASH. The default of `label` is
    the name of the scenario.
    """
    if existing not in (None, *get_args(Existing)):
        raise CosimError(f"existing is {existing!r}; None, 'keep' or 'overwrite' is expected")
    if directory is None and existing is not None:
        raise CosimError(f"--{existing} applies to a directory that is given (--out); a new directory is empty")  # fmt: skip
    if directory is None:
        return RunDirectory.unique(label or scenario.name, scenario.source)
    return RunDirectory.claim(Path(text_of(directory, "the directory", OutputError)), existing)


def parameters(
    scenario: Scenario | str | os.PathLike[str], changes: Changes = ()
) -> dict[str, Any]:
    """Return all parameters of a scenario: {"manipulator_controller.stiffness": [500.0, ...], ...}.

    The values are those that a run uses, after `changes` and all references: numbers, lists,
    Booleans, and names of enumeration values, in the units of docs/fmu_variables.md. Raises
    CosimError.
    """
    chosen = loaded(scenario, changes)
    with assembled(chosen) as (master, values):
        found = provenance(chosen, master, values).parameters
    return {f"{name}.{key}": value for name, own in found.items() for key, value in own.items()}


def provenance(scenario: Scenario, master: Master, values: Values) -> Provenance:
    """Return the provenance of the record that `master` wrote.

    It contains the steps [ns], the connections and the parameters. `values` has the parameter
    values that the scenario sets. All other parameters have their start values.
    """
    components, schedule = master.graph.components, master.schedule
    return Provenance(
        scenario=scenario.name,
        exchange=scenario.exchange,
        steps={name: ratio * schedule.tick for name, ratio in schedule.ratios.items()},
        parameters={
            name: {
                port.name: _plain(port, current(components, values, name, port.name))
                for port in component.ports.values()
                if port.settable
            }
            for name, component in components.items()
        },
        sources={connection.target: connection.source for connection in master.graph.connections},
    )


def _plain(port: Port, value: Array) -> Any:
    """Return the value of a parameter as a JSON type. An enumeration value becomes its name."""
    if port.choices and value.size == 1 and 1 <= value[0] <= len(port.choices):
        return port.choices[int(value[0]) - 1]
    if port.boolean:
        value = value.astype(bool)
    return value[0].item() if port.size == 1 else value.tolist()


@contextmanager
def progress_bar(console: Console, scenarios: Sequence[Scenario]) -> Iterator[dict[str, Report]]:
    """Show a progress bar for each scenario, if `console` is a terminal.

    Yields a dictionary from scenario names to progress functions. The argument of a progress
    function is the simulated time [s].
    """
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} s"),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        reports: dict[str, Report] = {}
        for scenario in scenarios:
            task = bar.add_task(scenario.name, total=seconds(scenario.stop))
            reports[scenario.name] = lambda time, task=task: bar.update(task, completed=time)  # type: ignore[misc]
        yield reports
