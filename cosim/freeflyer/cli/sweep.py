"""The command `freeflyer sweep`. Dask is imported only when a sweep starts."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.cli.run import add_fmi, add_overrides
from freeflyer.foundation.errors import ScenarioError, report_error
from freeflyer.foundation.exit_codes import DONE, STOPPED
from freeflyer.foundation.output_file import folder

if TYPE_CHECKING:
    from freeflyer.analysis.sweep.file import Map
    from freeflyer.analysis.sweep.plan import Plan
    from freeflyer.analysis.sweep.results import Results
    from freeflyer.analysis.sweep.run import Ended
    from freeflyer.fmi.component import Array


class SweepCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "sweep", metavar="SWEEP", help=f"{', '.join(sweep_file.shipped())}, or a .toml file"
        )
        add_overrides(parser, "change a value in all runs")
        add_fmi(parser)
        parser.add_argument(
            "--scheduler",
            metavar="ADDRESS",
            help="address of a Dask scheduler, tcp://HOST:PORT (default: workers on this machine)",
        )
        parser.add_argument(
            "--workers",
            type=int,
            metavar="N",
            help="number of workers on this machine (default: one per core)",
        )
        parser.add_argument(
            "--out",
            type=folder,
            metavar="DIR",
            help="default: freeflyer_out/SWEEP; an unfinished sweep in this directory is resumed",
        )

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        if arguments.workers is not None and arguments.workers < 1:
            raise ScenarioError(f"--workers {arguments.workers}: at least one worker is expected")
        if arguments.workers is not None and arguments.scheduler is not None:
            raise ScenarioError(
                "--workers starts workers on this machine, but a scheduler already has workers: give either --workers or --scheduler"
            )
        chosen = sweep_file.read(arguments.sweep, arguments.overrides)

        from freeflyer.analysis.sweep import boundary
        from freeflyer.analysis.sweep.plan import Plan
        from freeflyer.analysis.sweep.results import Results

        plan = Plan(chosen, arguments.fmi)
        boundary.check(plan)
        directory = arguments.out or Path("freeflyer_out") / chosen.name
        results = Results(directory, plan)
        with results.opened():
            if results.runs:
                console.print(
                    f"{len(results.runs)} of {len(plan)} runs are in {directory} already",
                    soft_wrap=True,
                )
            ended = compute(plan, results, arguments.scheduler, arguments.workers, console)
            if ended is not None and ended.interrupted:
                return report_error(
                    f"interrupted after {len(results.runs)} of {len(plan)} runs; the same command computes the remaining runs",
                    STOPPED,
                )
            report(plan, results, console)
        return DONE


def compute(
    plan: Plan, results: Results, scheduler: str | None, workers: int | None, console: Console
) -> Ended | None:
    """Compute the unfinished runs. Return None if all runs are finished already.

    A progress bar is shown on a terminal.
    """
    if len(results.runs) == len(plan):
        return None
    from freeflyer.analysis.sweep import run as sweep
    from freeflyer.analysis.sweep.cluster import connected

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("runs"),
        TimeRemainingColumn(),
    )
    with (
        connected(scheduler, workers) as client,
        Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar,
    ):
        task = bar.add_task(plan.sweep.name, total=len(plan), completed=len(results.runs))
        return sweep.run(
            plan, results, client, lambda finished: bar.update(task, completed=finished)
        )


def report(plan: Plan, results: Results, console: Console) -> None:
    """Write the table of all runs and the stability map.

    Print the shares of stable and diverged runs, and the names of the files.
    """
    from freeflyer.analysis.sweep import evaluation
    from freeflyer.analysis.sweep import results as sweep_results

    # Print, for each case, the shares of stable and diverged runs.
    table = results.write()
    shares = Table(title=plan.sweep.title, title_justify="left")
    shares.add_column("case")
    for name in ("runs", "stable", "diverged", "failed"):
        shares.add_column(name, justify="right")
    counted = sweep_results.per_case(table)
    for case in counted:
        judged = case["runs"] - case["unjudged"]
        shares.add_row(
            case["case"],
            str(case["runs"]),
            percent(case["stable"], judged) if judged else "too short",
            percent(case["diverged"], case["runs"]),
            str(case["failed"]),
        )
    console.print(shares)
    cause = sweep_results.frequent_failure(table)
    if cause:
        console.print(f"Most frequent failure: {cause}", soft_wrap=True)
    # Draw the stability map, if the sweep has a stability map.
    written = [sweep_results.RESULTS]
    if plan.sweep.map is not None:
        from freeflyer.analysis.figure_style import save
        from freeflyer.analysis.sweep import map as stability_map

        figure = plan.sweep.map
        lines = predicted(plan, figure, console) if figure.predict else None
        save(
            stability_map.draw(table, figure.x, figure.y, plan.units, lines),
            results.directory / "stability_map",
        )
        written += ["stability_map.png", "stability_map.pdf"]
    if plan.evaluation is not None:
        axes = [str(axis.target) for axis in plan.axes]
        rows, by = table.to_pylist(), str(plan.sweep.evaluation)
        console.print(
            evaluation.reported(plan.evaluation, by, rows, axes, results.directory),
            soft_wrap=True,
        )
    console.print(f"Results in {results.directory}: {', '.join(written)}", soft_wrap=True)


def predicted(plan: Plan, figure: Map, console: Console) -> Mapping[str, tuple[Array, Array]]:
    """Predict the stability boundary of each case from the linearised loop.

    For each value on the y axis of the map, the boundary has one point. The computation of a point
    takes about 1 s. A progress bar is shown on a terminal.
    """
    from freeflyer.analysis.sweep import boundary

    columns = (TextColumn("predicted boundary"), BarColumn(), MofNCompleteColumn())
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task("", total=boundary.points(plan, figure))

        def done(note: str | None) -> None:
            bar.advance(task)
            if note:
                console.print(f"Note: {note}", soft_wrap=True)

        return boundary.predicted(plan, figure, done)


def percent(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:.1f} %"
