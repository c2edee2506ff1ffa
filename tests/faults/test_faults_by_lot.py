"""Random schedules of faults: never an illegal state, never a command beyond its limits, never NaN (`fault_bench.assert_safe`)."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from schedules import ending, schedule

SEEDS = 100
MANY = 10_000


@pytest.mark.parametrize("seed", range(1, SEEDS + 1))
def test_whatever_the_faults_the_arm_ends_braked_and_nothing_was_beyond_its_limits(seed: int) -> None:
    assert "otherwise" not in ending(schedule(seed))


def test_a_seed_gives_the_same_run_every_time() -> None:
    first, second = schedule(11), schedule(11)
    assert first.stop == second.stop
    assert first.events == second.events
    assert first.true_states == second.true_states


@pytest.mark.benchmark
def test_ten_thousand_schedules() -> None:
    """Two processes; some 40 minutes."""
    script = Path(__file__).with_name("schedules.py")
    half = MANY // 2
    running = [
        subprocess.Popen([sys.executable, str(script), str(first), str(half)], env={**os.environ, "OMP_NUM_THREADS": "1"})
        for first in (1, 1 + half)
    ]
    assert [process.wait() for process in running] == [0, 0]
