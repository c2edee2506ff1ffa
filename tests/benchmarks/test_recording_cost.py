"""Cost of a recording: time per row in the loop, CPU load of the recorder, bytes on disk.

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
from freeflyer_adapters.recording.client import Recording, RecordingClient

pytestmark = pytest.mark.benchmark
SECONDS = 20.0
HERTZ = os.sysconf("SC_CLK_TCK")


def processor_time(pid: int) -> float:
    """Return the CPU time of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / HERTZ


def resident(pid: int) -> float:
    """Return the resident memory of a process [MiB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def test_cost_of_a_recording_in_the_loop_and_in_the_recorder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Each row is timed in the loop; the recorder is measured at 10 s and near the end.
    took: list[int] = []
    seen: list[tuple[float, float, float]] = []
    original = RecordingClient.write

    def timed(self: RecordingClient, k: int) -> None:
        start = time.perf_counter_ns()
        original(self, k)
        took.append(time.perf_counter_ns() - start)
        if k in (10_000, round(SECONDS * 1000) - 100) and self.recorder is not None:
            seen.append((time.monotonic(), processor_time(self.recorder), resident(self.recorder)))

    monkeypatch.setattr(RecordingClient, "write", timed)
    chosen = scenario.load("facility", [f"stop_s={SECONDS}"])
    result, report = hil.run(
        chosen, simulated=True, recording=Recording(directory=tmp_path), show=lambda text: None
    )
    # Nothing is lost.
    assert result.as_expected
    assert report.recording is not None
    assert report.recording["missing"] == []
    # Results.
    cost = np.array(took[100:]) / 1e3
    (start, used, memory), (end, used_then, memory_then) = seen
    share = (used_then - used) / (end - start)
    size = (tmp_path / "recording.mcap").stat().st_size
    print(
        f"\nrow in the loop: least {cost.min():.1f}, p50 {np.median(cost):.1f}, p99 {np.percentile(cost, 99):.1f} us"
    )
    print(
        f"recorder: {share:.3f} of a core, {memory_then:.0f} MiB, {(memory_then - memory) / (end - start) * 3600:.0f} MiB more per hour"
    )
    print(f"recording: {size / SECONDS / 1e6:.2f} MB/s, {report.recording['rows_lost']} rows lost")
    start = time.perf_counter()
    frame = read_recording(tmp_path / "recording.mcap")
    print(
        f"reading it into pandas: {time.perf_counter() - start:.2f} s for {len(frame)} rows of {frame.shape[1]} columns"
    )
