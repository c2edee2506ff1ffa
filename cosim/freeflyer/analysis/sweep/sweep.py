"""Run a sweep, and its results."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from freeflyer.analysis.sweep import boundary, evaluation
from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.analysis.sweep import results as sweep_results
from freeflyer.analysis.sweep.plan import Plan
from freeflyer.analysis.sweep.results import Results
from freeflyer.foundation.errors import CosimError, ScenarioError
from freeflyer.foundation.keys import fits
from freeflyer.foundation.table import Shown, Table
from freeflyer.scenario.overrides import Changes

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Progress = Callable[[int, int], None]
"""Function that is called with the number of finished runs, and the number of all runs."""
Note = Callable[[str | None], None]
WORKERS_PER_CORE, FEWEST_WORKERS = 4, 8
"""Largest number of workers on this machine: 4 for each core, and at least 8.

More workers do not compute faster, and each worker needs about 100 MB.
"""


@dataclass(frozen=True, kw_only=True, repr=False)
class SweepResult(Shown):
    """Results of a sweep.

    `runs` has one row for each finished run, with the columns of results.parquet (docs/sweeps.md).
    `directory` contains the files of the sweep. `interrupted` is true if Ctrl-C ended the sweep.
    The same call then computes the remaining runs.
    """

    plan: Plan
    runs: pa.Table
    directory: Path
    interrupted: bool

    def to_pandas(self) -> pandas.DataFrame:
        """Return `runs` as a data frame. `attrs["units"]` has the units of the columns."""
        frame = self.runs.to_pandas()
        frame.attrs["units"] = {
            field.name: (field.metadata or {}).get(b"unit", b"").decode()
            for field in self.runs.schema
        }
        return frame

    @property
    def table(self) -> Table:
        """Shares of stable and diverged runs in each case."""
        rows = []
        for case in sweep_results.per_case(self.runs):
            judged = case["runs"] - case["unjudged"]
            rows.append(
                (
                    case["case"],
                    str(case["runs"]),
                    _percent(case["stable"], judged) if judged else "too short",
                    _percent(case["diverged"], case["runs"]),
                    str(case["failed"]),
                )
            )
        return Table(
            title=self.plan.sweep.title,
            header=("case", "runs", "stable", "diverged", "failed"),
            rows=rows,
        )

    def plot(self, done: Note | None = None) -> Figure:
        """Return the stability map. Raises CosimError if the sweep has no table [map].

        If the map has a predicted boundary, `done` is called after each of its points, with a
        message if the prediction failed, otherwise with None.
        """
        from freeflyer.analysis.sweep import map as stability_map

        figure = self.plan.sweep.map
        if figure is None:
            raise CosimError(
                f"sweep {self.plan.sweep.name} has no [map] with two axes; plot columns of `to_pandas()` instead"
            )
        lines = (
            boundary.predicted(self.plan, figure, done or (lambda note: None))
            if figure.predict
            else None
        )
        return stability_map.draw(self.runs, figure.x, figure.y, self.plan.units, lines)

    def report(self) -> Any:
        """Return the report of the sweep's own evaluation, or None. Raises CosimError."""
        if self.plan.evaluation is None:
            return None
        axes = [str(axis.target) for axis in self.plan.axes]
        by = str(self.plan.sweep.evaluation)
        rows = self.runs.to_pylist()
        return evaluation.reported(self.plan.evaluation, by, rows, axes, self.directory)


def sweep(
    source: str | os.PathLike[str] | Mapping[str, Any],
    changes: Changes = (),
    *,
    directory: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    fmi: int | None = None,
    progress: Progress | None = None,
) -> SweepResult:
    """Run one scenario many times on all cores or on a Dask cluster.

    `source` is the name of a shipped sweep, the path of a sweep file (.toml), or a mapping with the
    keys of such a file: {"scenario": "robust", "grid": {"base_controller.period": ["0.1 s", 0.3]}}.
    `changes` apply to all runs; they are those of `freeflyer.load`. Every finished run is kept in
    `directory` (default: freeflyer_out/NAME), and an unfinished sweep there is resumed. `workers`
    is the number of worker processes on this machine (default: one for each core; at most 4 for
    each core, or 8). `scheduler` is the address of a Dask scheduler (tcp://HOST:PORT), `fmi` the
    FMI version of the shipped FMUs. `progress` is called with the number of finished runs and the
    number of all runs. Raises CosimError.
    """
    cores = os.cpu_count() or 1
    most = max(FEWEST_WORKERS, WORKERS_PER_CORE * cores)
    if workers is not None and not fits(workers, {"type": "integer", "minimum": 1}):
        raise ScenarioError(f"--workers {workers!r}: at least one worker is expected")
    if workers is not None and workers > most:
        raise ScenarioError(
            f"--workers {workers}: at most {most} workers are expected, because this machine has {cores} cores"
        )
    if workers is not None and scheduler is not None:
        raise ScenarioError(
            "--workers starts workers on this machine, but a scheduler already has workers: give either --workers or --scheduler"
        )
    chosen = sweep_file.read(source, changes)
    plan = Plan(chosen, fmi)
    boundary.check(plan)
    results = Results(Path(directory or Path("freeflyer_out") / chosen.name), plan)
    report = progress or (lambda finished, total: None)
    with results.opened():
        report(len(results.runs), len(plan))
        interrupted = False
        if len(results.runs) < len(plan):
            from freeflyer.analysis.sweep import run
            from freeflyer.analysis.sweep.cluster import connected

            with connected(scheduler, workers) as client:
                ended = run.run(plan, results, client, lambda number: report(number, len(plan)))
            interrupted = ended.interrupted
        runs = results.table() if interrupted else results.write()
    return SweepResult(plan=plan, runs=runs, directory=results.directory, interrupted=interrupted)


def _percent(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:.1f} %"
