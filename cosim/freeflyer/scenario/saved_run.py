"""Open the directory of a run again, and complete the directory of a run whose process has died."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from freeflyer.foundation import bounded_file
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import OutputError, RecordError, one_line
from freeflyer.foundation.toml_file import parsed
from freeflyer.master.master import Outcome
from freeflyer.master.provenance import Provenance
from freeflyer.master.record import Record
from freeflyer.scenario import metrics, run_state, summary_file
from freeflyer.scenario.experiment import Result, result_of
from freeflyer.scenario.run_directory import RunDirectory
from freeflyer.scenario.run_state import DEAD, DESCRIPTION, RECORD, ROWS
from freeflyer.scenario.scenario import Scenario, from_tables

DIED = "the process ended before the run had finished"


def open_run(folder: Path) -> Result:
    """Return the result of a finished run from its directory. Nothing is simulated.

    Raises RecordError if the directory is not one of a finished run, or if the record has been
    changed after the run.
    """
    _check_finished(folder)
    summary = summary_file.read(folder)
    record = Record.read(folder / RECORD)
    if record.digest != summary["run"]["record_sha256"]:
        raise RecordError(f"{folder / RECORD} is not the record that the run has written: its content was changed; `Record.read` reads it without this check")  # fmt: skip
    scenario = _scenario(folder, summary["run"])
    try:
        outcome = Outcome(
            record=record,
            simulated=summary["simulated_s"],
            wall=math.nan if summary["wall_s"] is None else summary["wall_s"],
            **{
                key: summary[key] for key in ("steps", "diverged", "failed", "cause", "interrupted")
            },
        )
        errors = metrics.errors(scenario, record)
        result = Result(scenario=scenario, outcome=outcome, errors=errors, summary=summary)
        _ = result.table  # needs all values of summary.json
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise RecordError(f"{folder / 'summary.json'} was changed after the run: {one_line(error)}") from error  # fmt: skip
    return result


def _check_finished(folder: Path) -> None:
    """Raise RecordError if a directory is not one of a finished run."""
    try:
        found = run_state.state(folder)
    except OSError as error:
        raise RecordError(f"run {folder} cannot be read: {error.strerror}") from error
    if found in ("running", "incomplete"):
        what = (
            f"{run_state.owner(folder)} still writes it"
            if found == "running"
            else "its process has ended; `freeflyer recover` completes it"
        )
        raise RecordError(f"run {folder} is not finished: {what}")
    if found != "finished":
        raise RecordError(f"{folder} is not the directory of a run: it " + ("does not exist" if found == "missing" else "has no summary.json"))  # fmt: skip


def _scenario(folder: Path, run: dict[str, Any]) -> Scenario:
    try:
        raw = parsed(run["scenario"])
    except ValueError as error:
        raise RecordError(f"the scenario in the summary.json of {folder} is not valid TOML: {error}") from error  # fmt: skip
    found = from_tables(raw, Path(run["directory"], f"{run['name']}.toml"))
    return replace(found, ssp=run.get("ssp"), changes=tuple(run["changes"]))


def complete(
    directory: Path, recorded: Callable[[Scenario], Record] | None = None
) -> tuple[Result, RunDirectory]:
    """Write the results of a run whose process has died, from its rows.

    `recorded` returns the record of a run that has no rows, for example from its recording. The
    result has the verdict "interrupted", unless the last row is that at the stop time. Raises
    RecordError if the process still runs, or if no row was written. Raises OutputError.
    """
    claimed = RunDirectory.take_over(directory)
    with claimed:
        rows = directory / DEAD
        try:
            described = json.loads(bounded_file.content(rows / DESCRIPTION, summary_file.LARGEST))
            provenance = Provenance.from_json(json.dumps(described["provenance"]))
            about = described["run"]
            if summary_file.wrong_of_run({"record_sha256": "", **about}):
                raise ValueError
            scenario = _scenario(directory, about)
        except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
            raise RecordError(f"run {directory} had not begun when its process ended; there is nothing to recover, remove this directory") from error  # fmt: skip
        record = recorded(scenario) if recorded else Record.from_rows(rows / ROWS)
        if not record.rows:
            raise RecordError(
                f"run {directory} has no row; there is nothing to recover, remove this directory"
            )
        simulated = float(record.time[-1])
        early = simulated < seconds(scenario.stop)  # otherwise, only the results were not written
        record.provenance = replace(provenance, sampled_at_end=early)
        outcome = Outcome(
            record=record,
            simulated=simulated,
            wall=math.nan,
            steps={},
            interrupted=early,
            cause=DIED if early else None,
        )
        result = result_of(scenario, outcome, about)
        result.summary["wall_s"] = None  # type: ignore[index]
    try:
        result.finish(claimed)
    except OutputError:
        claimed.abandon()
        raise
    return result, claimed
