"""How late the loop wakes up beside a C loop in the same run, and the loop on the virtual facility for a minute.

Run alone: `pytest -m benchmark -n 0 -s tests/benchmarks/test_loop_times.py`.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from cosim import experiment, real_time, scenario

pytestmark = pytest.mark.benchmark
HERE = Path(__file__).parent
ROUNDS, COUNT = 10, 2000
PYTHON_LOOP = f"""
import json, sys, time
from adapters import pacing
pacing.enter_real_time(True)
pacer, late = pacing.Pacer(1_000_000), [0] * {COUNT}
with pacing.no_collection():
    pacer.wait()
    for i in range({COUNT}):
        pacer.wait()
        late[i] = pacer.late
print(json.dumps(late))
"""


def test_the_pacer_wakes_up_as_a_c_loop_does(tmp_path: Path) -> None:
    compiler = [shutil.which("gcc")] if shutil.which("gcc") else [sys.executable, "-m", "ziglang", "cc"]
    binary = tmp_path / "wake_up"
    subprocess.run([*compiler, "-O2", str(HERE / "wake_up.c"), "-o", str(binary)], check=True)
    c, python = [], []
    for _ in range(ROUNDS):  # in turn, so that what disturbs the machine disturbs both
        done = subprocess.run([str(binary), str(COUNT)], check=True, capture_output=True, text=True)
        c.append(np.array(done.stdout.split(), dtype=float) / 1e3)
        done = subprocess.run([sys.executable, "-c", PYTHON_LOOP], check=True, capture_output=True, text=True)
        python.append(np.array(json.loads(done.stdout), dtype=float) / 1e3)
    print(f"\nwake-up lateness at 1 kHz under SCHED_FIFO, {ROUNDS} rounds of {COUNT} in turn; medians over the rounds [us]")
    for share in (50, 99):
        ours, theirs = (float(np.median([np.percentile(part, share) for part in parts])) for parts in (python, c))
        print(f"  p{share}: Python {ours:.0f}, C {theirs:.0f}, ratio {ours / theirs:.2f}")
        assert ours < 10.0 * theirs  # gross regressions only
    print(f"  longest: Python {max(map(np.max, python)):.0f}, C {max(map(np.max, c)):.0f}")


def test_a_minute_on_the_virtual_facility(tmp_path: Path) -> None:
    """With every rule at its default; a machine that holds a process up for longer than a rule allows stops it, and it says so."""
    chosen = scenario.load("facility", ["stop_s=60.0"])
    without_clock = experiment.run(chosen).summary
    for attempt in range(3):
        result = real_time.run(chosen, tmp_path / str(attempt), ["stop_s=60.0"])
        facility = json.loads((tmp_path / str(attempt) / "facility.json").read_text())
        print(f"\nattempt {attempt + 1}: {result.outcome.simulated:g} s; {result.summary['real_time']['stop']}")
        for name in ("end_effector_position_error_m", "base_position_error_m", "end_effector_orientation_error_deg",
                     "base_orientation_error_deg"):  # fmt: skip
            print(f"  {name}: {result.summary[name]['max']:.4g}, without a wall clock {without_clock[name]['max']:.4g}")
        for name, times in {**result.summary["real_time"]["times"], **facility["times"]}.items():
            print(f"  {name}: p50 {times['p50_us']:.0f}, p99 {times['p99_us']:.0f}, longest {times['max_us']:.0f} us")
        for counts in (*result.summary["real_time"]["devices"].items(), *facility["devices"].items()):
            print(f"  {counts}")
        if result.as_expected:
            break
        time.sleep(1.0)
    assert result.outcome.steps["arm_drive"] > 0
