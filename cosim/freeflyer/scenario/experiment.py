"""Run one scenario and write its results."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from freeflyer.fmi.component import Array, Port
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.interrupts import interrupts
from freeflyer.foundation.output_file import write_text
from freeflyer.master import native
from freeflyer.master.master import Master, Outcome
from freeflyer.master.master import Progress as Report
from freeflyer.master.provenance import Provenance
from freeflyer.scenario import metrics
from freeflyer.scenario.assemble import assembled
from freeflyer.scenario.parameters import Values, current
from freeflyer.scenario.scenario import Scenario
from freeflyer.scenario.verdict import as_expected


@dataclass(frozen=True, kw_only=True)
class Result:
    """Results of a run.

    `errors` maps the name of an error in summary.json to its time series. A time series has one
    value for each row of the record.
    """

    scenario: Scenario
    outcome: Outcome
    errors: Mapping[str, Array]
    summary: Mapping[str, Any]

    @property
    def as_expected(self) -> bool:
        """Whether the run ended in the way that the scenario expects: completed or diverged."""
        return as_expected(self.scenario, self.outcome)


Engine = Literal["core", "python"]
"""The implementation that steps the components during a run.

"core" is the C code (`freeflyer.master.native`). "python" is `Master.run`, which uses FMPy.
Both engines give the same numbers.
"""


def run(
    scenario: Scenario,
    *,
    fmi: int | None = None,
    progress: Report | None = None,
    engine: Engine = "core",
) -> Result:
    """Load, check and simulate a scenario, and compute its errors and summary.

    `fmi`, if given, overrides the FMI version of all FMUs. `progress` is called with the simulated
    time [s] during the run.
    Raises CosimError for an error before the first step. An error in a step ends the run without an
    exception. It is then in `outcome` of the result.
    """
    with assembled(scenario, fmi) as (master, values):
        metrics.check(scenario, master.graph.components)
        # If Ctrl-C ends the simulation, the results up to then are kept and summarised.
        with interrupts():
            outcome = native.run(master, progress) if engine == "core" else master.run(progress)
            outcome.record.provenance = provenance(scenario, master, values)
            series = metrics.errors(scenario, outcome.record, master.graph.components, values)
            summary = metrics.summary(scenario, outcome, series)
    return Result(scenario=scenario, outcome=outcome, errors=series, summary=summary)


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


def write(result: Result, directory: Path) -> None:
    """Write record.parquet and summary.json. Raises OutputError.

    Each file is written atomically.
    """
    with interrupts():  # after Ctrl-C during the first file, the second file is still written
        result.outcome.record.write(directory / "record.parquet")
        write_text(directory / "summary.json", json.dumps(result.summary, indent=2) + "\n")


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
