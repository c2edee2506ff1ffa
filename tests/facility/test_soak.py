"""Soak tests at 1 kHz over real sockets: constant memory, and equal counts on both sides.

The slow test takes two minutes. The benchmark takes twenty minutes:
`pytest -m benchmark -n 0 -s tests/facility/test_soak.py`.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from processes import PATIENT_FACILITY, PATIENT_LOOP, Process, rig

PAGE = 4096
SETTLED = 10.0
"""Time after activation until all single allocations are done [s]."""
ALLOWED = 1.5
"""Allowed total growth [MB], independent of the duration: allocators keep some pages."""
SCENARIO = """extends = "facility"
stop_s = {seconds}
[record]
every_s = 0.1
[components.reference_trajectory.parameters]
duration = {seconds}
"""


def resident(process: Process) -> float:
    """Return the resident memory of a process [MB]."""
    return int(Path(f"/proc/{process.popen.pid}/statm").read_text().split()[1]) * PAGE / 1e6


def soak(folder: Path, seconds: float) -> None:
    path = folder / "soak.toml"
    path.write_text(SCENARIO.format(seconds=seconds))
    with rig(folder, str(path)) as bench:
        facility = bench.facility(*PATIENT_FACILITY)
        loop = bench.hil(*PATIENT_LOOP)
        facility.wait_for("inactive -> active: commanded")
        time.sleep(min(SETTLED, 0.25 * seconds))
        memory = []
        while loop.popen.poll() is None and time.monotonic():
            try:
                memory.append((resident(loop), resident(facility)))
            except (OSError, IndexError):
                break
            time.sleep(1.0)
        assert loop.finish(timeout=seconds) == 0, loop.text
        time.sleep(1.5)  # the facility must detect the end of its controller
        report, summary = bench.facility_report(facility), bench.summary()

    # The last values may be of a loop that is writing its results.
    settled = np.array(memory[: -int(min(5, len(memory) // 4))])
    growth = settled.max(axis=0) - settled[0]
    arm, base = (summary["real_time"]["devices"][name] for name in ("arm_drive", "base_robot"))
    theirs, robot = (report["devices"][name] for name in ("arm_drive", "base_robot"))
    print(
        f"\n{seconds:g} s: loop {settled[0, 0]:.1f} MB and {growth[0]:+.2f}, facility {settled[0, 1]:.1f} MB and {growth[1]:+.2f}"
    )
    print(
        f"arm, here {dict(arm)}\narm, there {dict(theirs)}\nbase, here {dict(base)}\nbase, there {dict(robot)}"
    )
    assert (growth < ALLOWED).all(), growth

    assert summary["steps"]["arm_drive"] == round(seconds * 1000)
    # Every command arrived. Both sides agree on the commands in time.
    assert theirs["commands_accepted"] + theirs["commands_rejected"] == arm["commands_sent"]
    assert theirs["commands_rejected"] == arm["state_frames_rejected"] == 0
    assert (
        abs(theirs["commands_late_or_lost"] - arm["commands_late_or_lost"])
        <= arm["cycles_lost"] + 5
    )
    assert theirs["state_frames_sent"] >= arm["state_frames_accepted"]
    # Only the latest sample is read. Samples read and samples overwritten are both counted.
    assert base["samples_refused"] == robot["setpoints_refused"] == 0
    cycles = seconds * 250
    assert base["samples_accepted"] + base["samples_skipped"] == pytest.approx(
        cycles, abs=0.01 * cycles + 300
    )
    received = sum(
        robot[f"setpoints_{how}"] for how in ("accepted", "skipped", "before_the_first_followed")
    )
    assert received == pytest.approx(base["setpoints_published"], abs=3)
    assert robot["setpoints_before_the_first_followed"] <= 20


@pytest.mark.slow
def test_memory_and_counts_over_two_minutes(tmp_path: Path) -> None:
    soak(tmp_path, 120.0)


@pytest.mark.benchmark
def test_memory_and_counts_over_twenty_minutes(tmp_path: Path) -> None:
    soak(tmp_path, 1200.0)
