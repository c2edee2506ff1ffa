"""Sweeps of short runs. Each run writes a mark, so that a test can count runs and their workers."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas
import psutil
import pytest

from freeflyer.cli import main as command

MARKING = Path(__file__).parents[1] / "data" / "marking.py"
PATIENCE = 90.0
"""Timeout of all waits, with margin for a busy machine [s]."""


class MarkedSweep:
    """Scenario and sweep file in `directory`, with runs x = 1 ... `count` of `nap` seconds each.

    The run x = `deadly` kills its worker. `more` is inserted into the head of the sweep file.
    """

    def __init__(
        self, directory: Path, *, count: int, nap: float = 0.0, deadly: int = -1, more: str = ""
    ) -> None:
        self.count, self.out, self.marks = count, directory / "out", directory / "marks"
        self.marks.mkdir()
        scenario = directory / "marked.toml"
        scenario.write_text(
            f'stop_s = 1\nrecord.every_s = 1\n[components.one]\nkind = "python"\nobject = "{MARKING}:make"\nstep_s = 1\n'
            f"[components.one.parameters]\nnap = {nap}\ndeadly = {deadly}\n"
        )
        self.file = directory / "sweep.toml"
        values = list(range(1, count + 1))
        self.file.write_text(f'scenario = "marked.toml"\n{more}\n[grid]\n"one.x" = {values}\n')

    def start(self) -> subprocess.Popen[str]:
        """Start the command in its own process, with two workers."""
        return subprocess.Popen(
            [
                sys.executable,
                "-m",
                "freeflyer.cli.main",
                "sweep",
                str(self.file),
                "--out",
                str(self.out),
                "--workers",
                "2",
            ],
            env=os.environ | {"MARKS": str(self.marks)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # own process group, as in a terminal
        )

    def run(self, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, str, str]:
        """Run the command in this process. Returns the exit code, standard output and error output.

        The workers inherit the directory of the marks.
        """
        capsys.readouterr()
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("MARKS", str(self.marks))
            code = command.call(
                ["sweep", str(self.file), "--out", str(self.out), *(options or ("--workers", "1"))]
            )
        return code, *capsys.readouterr()

    def times_run(self, x: int) -> int:
        mark = self.marks / str(x)
        return len(mark.read_text().splitlines()) if mark.exists() else 0

    @property
    def parts(self) -> dict[str, tuple[int, bytes]]:
        """Modification time [ns] and content of every finished part."""
        return {
            path.name: (path.stat().st_mtime_ns, path.read_bytes())
            for path in (self.out / "parts").glob("*.parquet")
        }

    @property
    def results(self) -> pandas.DataFrame:
        return pandas.read_parquet(self.out / "results.parquet")


def until(condition: Callable[[], bool], process: subprocess.Popen[Any]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end, "the condition was not met in time"
        time.sleep(0.02)


def workers_of(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """Return the worker processes of a sweep command, without Python's resource tracker."""
    children = psutil.Process(process.pid).children(recursive=True)
    return [child for child in children if "spawn_main" in " ".join(child.cmdline())]


def kill_9(process: psutil.Process) -> None:
    os.kill(process.pid, signal.SIGKILL)
