"""Sweeps of quick runs that leave a mark each, so that a test sees what was run, how often and by whom."""

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
"""Longer than anything takes on a busy machine [s]."""


class MarkedSweep:
    """A scenario and a sweep file in `directory`, with runs x = 1 ... count that take `nap` seconds each."""

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
        """As a command of its own, with two workers."""
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
            start_new_session=True,  # a group of its own, as a terminal gives it
        )

    def run(self, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, str, str]:
        """In this process, which has imported everything already; its workers inherit where marks belong."""
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
        """Time and contents of every finished part."""
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
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.02)


def workers_of(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """Worker processes of a sweep's command, without Python's own helper."""
    children = psutil.Process(process.pid).children(recursive=True)
    return [child for child in children if "spawn_main" in " ".join(child.cmdline())]


def kill_9(process: psutil.Process) -> None:
    os.kill(process.pid, signal.SIGKILL)
