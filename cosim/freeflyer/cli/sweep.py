"""The command `freeflyer sweep`. Dask is imported only when a sweep starts."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.cli.console import as_rich
from freeflyer.cli.run import add_fmi, add_overrides
from freeflyer.foundation.errors import report_error
from freeflyer.foundation.exit_codes import DONE, STOPPED
from freeflyer.foundation.output_file import folder

if TYPE_CHECKING:
    from freeflyer.analysis.sweep.sweep import SweepResult


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
        from freeflyer.analysis.sweep.sweep import sweep

        chosen = sweep_file.read(arguments.sweep, arguments.overrides)
        directory = arguments.out or Path("freeflyer_out") / chosen.name
        with _bar(console, chosen.name, MofNCompleteColumn(), TextColumn("runs")) as update:

            def progress(finished: int, total: int) -> None:
                if update(finished, total) and finished:
                    console.print(
                        f"{finished} of {total} runs are in {directory} already", soft_wrap=True
                    )

            result = sweep(
                arguments.sweep,
                arguments.overrides,
                directory=directory,
                workers=arguments.workers,
                scheduler=arguments.scheduler,
                fmi=arguments.fmi,
                progress=progress,
            )
        if result.interrupted:
            return report_error(
                f"interrupted after {len(result.runs)} of {len(result.plan)} runs; the same command computes the remaining runs",
                STOPPED,
            )
        report(result, console)
        return DONE


def report(result: SweepResult, console: Console) -> None:
    """Write the stability map. Print the shares of stable and diverged runs, and the files."""
    from freeflyer.analysis.sweep import boundary, results

    console.print(as_rich(result.table))
    cause = results.frequent_failure(result.runs)
    if cause:
        console.print(f"Most frequent failure: {cause}", soft_wrap=True)
    written = [results.RESULTS]
    figure = result.plan.sweep.map
    if figure is not None:
        from freeflyer.scenario.figure_style import save

        # The computation of a point of the boundary takes about 1 s.
        with _bar(console, "predicted boundary", MofNCompleteColumn()) as update:
            points, total = 0, boundary.points(result.plan, figure)

            def done(note: str | None) -> None:
                nonlocal points
                points += 1
                update(points, total)
                if note:
                    console.print(f"Note: {note}", soft_wrap=True)

            drawn = result.plot(done)
        save(drawn, result.directory / "stability_map")
        written += ["stability_map.png", "stability_map.pdf"]
    own = result.report()
    if own is not None:
        console.print(own, soft_wrap=True)
    console.print(f"Results in {result.directory}: {', '.join(written)}", soft_wrap=True)


@contextmanager
def _bar(
    console: Console, text: str, *columns: ProgressColumn
) -> Iterator[Callable[[int, int], bool]]:
    """Show a progress bar on a terminal.

    Yields a function of the number of finished items and the number of all items. It returns
    whether it was called for the first time.
    """
    described = TextColumn("{task.description}", markup=False)
    with Progress(
        described,
        BarColumn(),
        *columns,
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bar:
        tasks: list[TaskID] = []

        def update(finished: int, total: int) -> bool:
            first = not tasks
            if first:
                tasks.append(bar.add_task(text, total=total))
            bar.update(tasks[0], completed=finished)
            return first

        yield update
