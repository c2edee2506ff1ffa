"""`freeflyer recover`."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from freeflyer.foundation.errors import RecordError
from freeflyer.foundation.exit_codes import DONE
from freeflyer.foundation.interrupts import interrupts
from freeflyer.scenario.run_directory import RunDirectory
from freeflyer.scenario.run_state import has_rows, is_run, newer_incomplete, owner, state
from freeflyer.scenario.saved_run import complete
from freeflyer_adapters.recording.recover import recover, rings_of, unfinished
from freeflyer_adapters.recording.view_reader import record_of


class RecoverCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "path",
            type=Path,
            metavar="PATH",
            help="FILE.mcap, FILE.blf, FILE.ring, or the directory of a run",
        )
        parser.add_argument(
            "--out",
            type=Path,
            metavar="FILE",
            help="new file (default: FILE_recovered in the same directory)",
        )

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        path, out = arguments.path, arguments.out
        if "\0" in str(path) or "\0" in str(out or ""):
            raise RecordError(
                "the file name contains a zero byte; a file name without zero bytes is expected"
            )
        paths, runs = [path], list[Path]()
        newer = newer_incomplete(path)
        if path.is_dir() or newer:
            if out is not None:
                raise RecordError(
                    f"--out {out}: {path} is a directory, and the recovered files are always written to this directory; omit --out"
                )
            for run in newer:
                console.print(f"{run} is newer and incomplete", soft_wrap=True)
            runs = [*newer, *([path] if path.is_dir() else [])]
            paths = [file for run in runs for file in unfinished(run)]
            runs = [run for run in runs if state(run) == "incomplete"]
            if (user := owner(path)) is not None:
                raise RecordError(f"{path} is in use by {user}; wait until the run ends")
            if not paths and not runs and is_run(path):
                console.print(f"{path} is complete; nothing was written", soft_wrap=True)
                return DONE
            if not paths and not runs:
                raise RecordError(
                    f"{path} has no rows of an incomplete run, no recording, no CAN log and no ring of a run"
                )
        elif path.suffix.lower() == ".mcap" and path.is_file():
            paths = [*rings_of(path.parent), path]
        with (
            interrupts() as asked,
            Progress(console=console, transient=True, disable=not console.is_terminal) as bar,
        ):
            for one in paths:
                task = bar.add_task(one.name)

                def show(done: int, size: int, task: object = task) -> None:
                    bar.update(task, completed=done, total=size)  # type: ignore[arg-type]
                    if asked:
                        raise KeyboardInterrupt

                done = recover(one, out if one is path else None, show)
                console.print(done.sentence, soft_wrap=True)
        # The folder `unfinished` is removed last: until then, the run stays incomplete.
        failures: list[RecordError] = []
        for run in runs:
            try:
                # A run with devices has no rows, but recordings.
                result, _ = complete(run, None if has_rows(run) else partial(record_of, run))
            except RecordError as error:  # the other runs are completed nevertheless
                if not has_rows(run) and state(run) == "incomplete":
                    RunDirectory.take_over(run).release()
                    console.print(f"{run}: no record, because {error}", soft_wrap=True)
                else:
                    failures.append(error)
                continue
            console.print(
                f"{run}: kept {result.record.rows} rows, up to {result.outcome.simulated:g} s: record.parquet, summary.json",
                soft_wrap=True,
            )
        if failures:
            raise RecordError("; ".join(map(str, failures)))
        return DONE
