"""CPU time of the start-up, as ratios within one run.

Run with: pytest -m benchmark -n 0 -s tests/benchmarks/test_start_up_cost.py
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

pytestmark = pytest.mark.benchmark

ROUNDS = 15
LEAST = "import argparse, importlib.metadata as m; m.entry_points(group='freeflyer.commands')"
"""The minimum for a command line with subcommands of other packages."""
FIRST_STEP = """
import sys, time
from freeflyer.cli import main as command
from freeflyer.master import native
def first(*_):
    print(time.process_time())
    sys.exit()
native.run = first
command.call(["run", "multirate_passive", "--out", sys.argv[1]])
"""


def cpu(command: Sequence[str]) -> float:
    """Run a command; return its user and system time [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def medians(commands: Mapping[str, Sequence[str]]) -> dict[str, float]:
    """Return the median times [s]; the commands alternate, because the machine's speed varies."""
    times: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(ROUNDS):
        for name, command in commands.items():
            times[name].append(cpu(command))
    return {name: statistics.median(found) for name, found in times.items()}


def test_help_takes_at_most_twice_the_time_of_finding_the_commands() -> None:
    script = str(Path(sys.executable).with_name("freeflyer"))
    times = medians({"least": [sys.executable, "-c", LEAST], "help": [script, "--help"]})
    ratio = times["help"] / times["least"]
    print(
        f"\nfreeflyer --help: {times['help']:.3f} s of CPU, {ratio:.2f} x argparse and the search of the entry points"
    )
    assert ratio <= 2.0


def test_time_to_the_first_integration_step(tmp_path: Path) -> None:
    """CPU time of `freeflyer run multirate_passive` up to the first step of the master."""
    times = []
    for _ in range(ROUNDS):
        done = subprocess.run(
            [sys.executable, "-P", "-c", FIRST_STEP, str(tmp_path)],
            capture_output=True,
            text=True,
            check=True,
        )
        times.append(float(done.stdout))
    numpy = statistics.median(cpu([sys.executable, "-c", "import numpy"]) for _ in range(ROUNDS))
    first = statistics.median(times)
    print(
        f"\nfirst integration step after {first:.2f} s of CPU, {first / numpy:.1f} x `import numpy`"
    )
    assert first < 8.0 * numpy  # gross regressions only
