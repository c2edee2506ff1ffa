"""Repeat one run of a sweep from its row in the table of results."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as compute
import pyarrow.parquet as parquet

from freeflyer.analysis.sweep.plan import Setup
from freeflyer.analysis.sweep.results import PARTS, PLAN, RESULTS
from freeflyer.analysis.sweep.task import measured
from freeflyer.foundation import bounded_file
from freeflyer.foundation.errors import RecordError, one_line
from freeflyer.scenario.experiment import Result
from freeflyer.scenario.scenario import Scenario, texts

LARGEST_PLAN = 64 << 20
"""Largest accepted size [bytes] of sweep.json."""
TIMES = ("wall_s", "run_s")
"""Columns that differ between two computations of the same run."""


def is_sweep(directory: Path) -> bool:
    """Return whether a directory is one of a sweep."""
    return (directory / PLAN).is_file()


@dataclass(frozen=True, kw_only=True)
class SweepRun:
    """Run `number` of a sweep: its scenario, the FMI version of the sweep, and its row."""

    scenario: Scenario
    fmi: int | None
    row: Mapping[str, Any]

    def differences(self, result: Result) -> list[str]:
        """Return what differs between a result of this run and its row, in sentences.

        The list is empty if all numbers are equal.
        """
        return [
            f"{name}: {value!r}, and {self.row.get(name)!r} in the row"
            for name, value in measured(result).items()
            if name not in TIMES and value != self.row.get(name)
        ]


def run_of(directory: Path, number: int) -> SweepRun:
    """Return run `number` of the sweep in a directory.

    Raises RecordError if the directory is not one of a sweep, or if the run is not in its table.
    Raises ScenarioError if the scenario in sweep.json is invalid.
    """
    row = _row(directory, number)
    try:
        found = json.loads(bounded_file.content(directory / PLAN, LARGEST_PLAN))
        plan = found["plan"]
        setup = Setup(
            tables=plan["scenario"],
            path=Path(found["directory"], f"{found['name']}.toml"),
            cases=plan["cases"],
            fmi=plan["fmi"],
            evaluation=None,
            files={},
        )
        changes = json.loads(row["changes"])
        everything = texts({**setup.cases[row["case"]], **changes})
    except OSError as error:
        raise RecordError(f"{directory / PLAN} cannot be read: {error.strerror}") from error
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise RecordError(f"{directory / PLAN} is not the plan of a sweep of this version: {one_line(error)}") from error  # fmt: skip
    scenario = setup.scenario(row["case"], tuple(changes.items()))
    return SweepRun(scenario=replace(scenario, changes=tuple(everything)), fmi=setup.fmi, row=row)


def _row(directory: Path, number: int) -> Mapping[str, Any]:
    """Return the row of a run. Raises RecordError."""
    if not is_sweep(directory):
        raise RecordError(f"{directory} is not the directory of a sweep: it has no {PLAN}")
    try:
        if (directory / RESULTS).exists():
            table = parquet.read_table(directory / RESULTS)
        else:
            parts = sorted((directory / PARTS).glob("runs_*.parquet"))
            table = pa.concat_tables([parquet.read_table(part) for part in parts])
        known = 0 <= number < 2**63
        rows = table.filter(compute.equal(table.column("run"), number)).to_pylist() if known else []
        if not rows:
            raise RecordError(f"{directory} has no run {number}: it has {table.num_rows} runs, counted from 0")  # fmt: skip
        if "changes" not in table.column_names:
            raise RecordError(f"{directory} was written by a version before 0.2.0, without what is needed to repeat a run")  # fmt: skip
    except (OSError, pa.ArrowException, LookupError) as error:
        raise RecordError(f"the results in {directory} cannot be read: {one_line(error, 200)}") from error  # fmt: skip
    row: Mapping[str, Any] = rows[0]
    return row
