"""Random schedules of faults: no illegal state, no command beyond its limits, no NaN.

The checks are in `fault_bench.assert_safe`.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from families import family
from fault_bench import JOINTS, Observed
from schedules import ending, schedule

from freeflyer_adapters.arm.frames import ArmFrames, FrameMapping

SEEDS = 100
MANY = 10_000


def summary(seen: Observed) -> tuple[object, ...]:
    """Return all observations except the controller's number, which differs in every run."""
    events = {
        name: [re.sub(r"controller \d+", "controller", event) for event in of]
        for name, of in seen.events.items()
    }
    state = ArmFrames(FrameMapping(), JOINTS).state
    positions = [state.unpack(data)["joint_position"] for data in seen.true_states]
    return seen.stop, events, positions, seen.stopped_at, len(seen.setpoints), seen.acted


@pytest.mark.parametrize("seed", family(range(1, SEEDS + 1), 12))
def test_random_faults_end_with_a_braked_arm_and_commands_within_limits(
    seed: int,
) -> None:
    assert "otherwise" not in ending(schedule(seed))


def test_a_seed_gives_the_same_run_every_time() -> None:
    first, second = (summary(schedule(11)) for _ in range(2))
    assert first == second


@pytest.mark.benchmark
def test_ten_thousand_schedules() -> None:
    """Two processes, about 40 minutes."""
    script = Path(__file__).with_name("schedules.py")
    half = MANY // 2
    running = [
        subprocess.Popen(
            [sys.executable, str(script), str(first), str(half)],
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        for first in (1, 1 + half)
    ]
    assert [process.wait() for process in running] == [0, 0]
