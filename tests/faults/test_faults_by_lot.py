"""Random schedules of faults: never an illegal state, never a command beyond its limits, never NaN (`fault_bench.assert_safe`)."""

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


def told(seen: Observed) -> tuple[object, ...]:
    """All that happened, but for the controller's number, which is drawn anew for every one."""
    events = {
        name: [re.sub(r"controller \d+", "controller", event) for event in of]
        for name, of in seen.events.items()
    }
    state = ArmFrames(FrameMapping(), JOINTS).state
    positions = [state.unpack(data)["joint_position"] for data in seen.true_states]
    return seen.stop, events, positions, seen.stopped_at, len(seen.setpoints), seen.acted


@pytest.mark.parametrize("seed", family(range(1, SEEDS + 1), 12))
def test_whatever_the_faults_the_arm_ends_braked_and_nothing_was_beyond_its_limits(
    seed: int,
) -> None:
    assert "otherwise" not in ending(schedule(seed))


def test_a_seed_gives_the_same_run_every_time() -> None:
    first, second = (told(schedule(11)) for _ in range(2))
    assert first == second


@pytest.mark.benchmark
def test_ten_thousand_schedules() -> None:
    """Two processes; some 40 minutes."""
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
