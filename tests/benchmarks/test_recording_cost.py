"""What a recording costs: the loop a row of numbers, the recorder a share of a core, the disk some bytes.

Run alone: `pytest -m benchmark -n 0 -s tests/benchmarks/test_recording_cost.py`.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest

from freeflyer.scenario import scenario
from freeflyer_adapters import read_recording
from freeflyer_adapters.loop import hil
from freeflyer_adapters.recording.client import Recording, Tap

pytestmark = pytest.mark.benchmark
SECONDS = 20.0
HERTZ = os.sysconf("SC_CLK_TCK")


def processor_time(pid: int) -> float:
    """[s]"""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / HERTZ


def resident(pid: int) -> float:
    """[MiB]"""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def test_the_loop_pays_microseconds_and_the_recorder_a_part_of_a_core(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    took: list[int] = []
    seen: list[tuple[float, float, float]] = []
    original = Tap.write

    def timed(self: Tap, k: int) -> None:
        begin = time.perf_counter_ns()
        original(self, k)
        took.append(time.perf_counter_ns() - begin)
        if k in (10_000, round(SECONDS * 1000) - 100) and self.recorder is not None:
            seen.append((time.monotonic(), processor_time(self.recorder), resident(self.recorder)))

    monkeypatch.setattr(Tap, "write", timed)
    chosen = scenario.load("facility", [f"stop_s={SECONDS}"])
    result, report = hil.run(
        chosen, simulated=True, recording=Recording(directory=tmp_path), say=lambda text: None
    )
    assert result.as_expected
    assert report.recording is not None
    assert report.recording["missing"] == []
    cost = np.array(took[100:]) / 1e3
    (begin, used, memory), (end, used_then, memory_then) = seen
    share = (used_then - used) / (end - begin)
    size = (tmp_path / "recording.mcap").stat().st_size
    print(
        f"\na row in the loop: least {cost.min():.1f}, p50 {np.median(cost):.1f}, p99 {np.percentile(cost, 99):.1f} us"
    )
    print(
        f"recorder: {share:.3f} of a core, {memory_then:.0f} MiB, {(memory_then - memory) / (end - begin) * 3600:.0f} MiB an hour more"
    )
    print(f"recording: {size / SECONDS / 1e6:.2f} MB/s, {report.recording['rows_lost']} rows lost")
    begin = time.perf_counter()
    frame = read_recording(tmp_path / "recording.mcap")
    print(
        f"reading it into pandas: {time.perf_counter() - begin:.2f} s for {len(frame)} rows of {frame.shape[1]} columns"
    )
