"""Scaling of a sweep, overhead of a run, memory of the command. Run with -m benchmark -n 0 -s.

The environment variables SWEEP_RUNS (default: 2000) and SWEEP_STOP [s] (default: 20) set the number
of runs and their stop time.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pandas
import pytest

pytestmark = pytest.mark.benchmark
RUNS = int(os.environ.get("SWEEP_RUNS", "2000"))
STOP = os.environ.get("SWEEP_STOP", "20")


def swept(directory: Path, workers: int, runs: int) -> tuple[float, float, pandas.DataFrame]:
    """Run a sweep; return runs per second, the command's peak memory [MB], and the table.

    The first batch does not count.
    """
    file, out = directory / f"sweep_{workers}.toml", directory / f"out_{workers}"
    file.write_text(
        f'scenario = "multirate_passive"\nset = ["stop_s={STOP}"]\n[sample]\ncount = {runs}\n'
        '[sample.parameters]\n"base_controller.period" = { low = 0.02, high = 0.2, multiple_of = 0.001 }\n'
    )
    code = (
        "import resource, sys\nfrom freeflyer.cli.main import call\n"
        "if __name__ == '__main__':\n    code = call(sys.argv[1:])\n"
        "    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)\n    sys.exit(code)\n"
    )
    command = directory / "command.py"
    command.write_text(code)
    arguments = ["sweep", str(file), "--workers", str(workers), "--out", str(out)]
    process = subprocess.Popen(
        [sys.executable, str(command), *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    _, error = process.communicate()
    assert process.returncode == 0, error
    parts = sorted(
        (path.stat().st_mtime, len(pandas.read_parquet(path))) for path in (out / "parts").iterdir()
    )
    frame = pandas.read_parquet(out / "results.parquet")
    assert len(frame) == runs
    assert not frame["failed"].any()
    return (runs - parts[0][1]) / (parts[-1][0] - parts[0][0]), int(error.split()[-1]) / 1024, frame


def test_two_workers_are_nearly_twice_as_fast_as_one_with_bounded_memory(tmp_path: Path) -> None:
    one, _, _ = swept(tmp_path, 1, RUNS // 4)
    two, memory, frame = swept(tmp_path, 2, RUNS)
    speed = two / one
    overhead = 1e3 * (frame["run_s"] - frame["wall_s"])
    print(
        f"\n{RUNS} runs of {STOP} s, {two:.1f} per second with two workers; {speed:.2f} times as fast as one"
    )
    print(
        f"overhead of a run besides stepping: {overhead.median():.1f} ms (median), {overhead.min():.1f} ms (least)"
    )
    print(f"peak memory of the command: {memory:.0f} MB; load {os.getloadavg()[0]:.1f}")
    assert memory < 400.0
    assert speed >= 1.85
