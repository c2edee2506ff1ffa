"""The wall clock is set during a run: recorded times do not jump, and the step is reported."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clocks import MONOTONIC, Clocks, run_head
from loops import START, TICK, head
from test_runs import run, signalled, while_it_runs

from freeflyer_adapters import read_recording
from freeflyer_adapters.facility.virtual_time import VirtualTime
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.environment import Environment
from freeflyer_adapters.recording.client import RecordingClient
from freeflyer_adapters.recording.recorder import Recorder, Written
from freeflyer_adapters.recording.ring import RingReader, RingWriter
from freeflyer_adapters.recording.ring_recovery import rescue
from freeflyer_adapters.recording.wall_clock import MOST_REPORTED, WallClock, offset_of

SECOND = 1_000_000_000
COUNT = 400


def recorded(out: Path, clocks: Clocks, steps: dict[int, int]) -> tuple[Written, list[str]]:
    """Record `COUNT` instants; the clock is set by `steps[k]` [ns] before instant k.

    Return the result of the recorder and its messages.
    """
    ring = RingWriter(run_head(out))
    messages: list[str] = []
    recorder = Recorder(RingReader(ring.path), messages.append)
    line = np.zeros(ring.width)
    for k in range(COUNT):
        clocks.set_by += steps.get(k, 0)
        ring.write(k, line)
        if k % 50 == 49:
            recorder.step()
        clocks.passed += TICK
    ring.set_reason("it was enough")
    written = recorder.finish()
    ring.close()
    return written, messages


@pytest.mark.parametrize(
    ("step", "direction"), [(-SECOND, "back by 1.000 s"), (-3600 * SECOND, "back by 3600.000 s"), (2 * SECOND, "forward by 2.000 s")]
)  # fmt: skip
def test_a_set_wall_clock_is_reported_and_the_times_continue_by_the_tick(
    step: int, direction: str, tmp_path: Path, runtime: Path, clocks: Clocks
) -> None:
    written, messages = recorded(tmp_path, clocks, {220: step})
    expected = f"this machine's clock was set {direction}, 0.2 s after the start; the times in the recording do not contain this step"
    assert written.clock_steps == messages == [expected]
    assert written.flight is not None
    for path in (tmp_path, Path(written.flight)):
        frame = read_recording(path)
        assert frame["wall_ns"].tolist() == [START + k * TICK for k in range(COUNT)]
        assert frame["monotonic_ns"].tolist() == [MONOTONIC + k * TICK for k in range(COUNT)]
        assert frame.attrs["stop"]["clock steps"] == expected


def test_each_step_is_reported_separately(tmp_path: Path, runtime: Path, clocks: Clocks) -> None:
    written, _ = recorded(tmp_path, clocks, {120: -SECOND, 320: SECOND})
    assert [text.split(";")[0] for text in written.clock_steps] == [
        "this machine's clock was set back by 1.000 s, 0.1 s after the start",
        "this machine's clock was set forward by 1.000 s, 0.3 s after the start",
    ]
    assert read_recording(tmp_path).attrs["stop"]["clock steps"].splitlines() == written.clock_steps


@pytest.mark.parametrize("steps", [{}, {100: -50_000_000}], ids=["no step", "a step of 0.05 s"])
def test_a_small_difference_is_not_reported(
    steps: dict[int, int], tmp_path: Path, runtime: Path, clocks: Clocks
) -> None:
    written, messages = recorded(tmp_path, clocks, steps)
    assert written.clock_steps == messages == []
    assert "clock steps" not in read_recording(tmp_path).attrs["stop"]


def test_a_clock_that_is_set_often_does_not_fill_the_result(clocks: Clocks) -> None:
    watched = WallClock.start()
    for k in range(3 * MOST_REPORTED):
        clocks.set_by = k % 2 * SECOND
        watched.check()
    assert len(watched.steps) == MOST_REPORTED + 1
    assert watched.steps[-1] == "further steps of this machine's clock are not reported"


def test_a_suspension_between_reading_two_clocks_is_not_a_step() -> None:
    class Suspended(Clocks):
        reads = 0

        def time_ns(self) -> int:
            self.reads += 1
            self.passed += SECOND if self.reads == 2 else 0
            return super().time_ns()

    assert offset_of(Suspended()) == START - MONOTONIC


def test_the_recorder_process_reports_a_step_in_its_result(tmp_path: Path, runtime: Path) -> None:
    """The start of the run is two seconds in the future, as if the clock had been set back."""
    now = WallClock.start()
    ring = RingWriter(
        replace(
            head(tmp_path), started=now.started + 2 * SECOND, clock_offset=now.offset + 2 * SECOND
        )
    )
    ring.write(0, np.zeros(ring.width))
    command = [sys.executable, "-P", "-m", "freeflyer_adapters.recording.recorder", str(ring.path)]
    done = subprocess.run(command, input="", capture_output=True, text=True, timeout=60.0)
    written = Written(**json.loads(done.stdout.splitlines()[-1]))
    (step,) = written.clock_steps
    assert step.startswith("this machine's clock was set back by 2.000 s, ")
    assert done.stderr == f"freeflyer: {step}\n"


class SetBack(Environment):
    """The clocks of the machine with a wall clock that is set by `set_by` [ns]."""

    set_by = 0

    def time_ns(self) -> int:
        return super().time_ns() + self.set_by


def test_with_a_killed_recorder_the_loop_reports_the_step(
    tmp_path: Path, runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clocks = SetBack()

    def set_back(client: RecordingClient) -> None:
        clocks.set_by = -SECOND

    with (
        environment.within(clocks),
        while_it_runs(monkeypatch, {50: signalled(signal.SIGKILL), 60: set_back}),
    ):
        _, recording = run(tmp_path, stop=0.2)
    assert recording["clock_steps"] == [
        "this machine's clock was set back by 1.000 s, some time during the run; the times in the recording do not contain this step"
    ]
    flight = read_recording(recording["flight"])
    assert flight.attrs["stop"]["clock steps"] == recording["clock_steps"][0]
    times = flight["wall_ns"].astype(np.int64) - flight["monotonic_ns"].astype(np.int64)
    assert times.nunique() == 1
    assert (
        read_recording(tmp_path / "out").attrs["stop"]["clock steps"] == recording["clock_steps"][0]
    )


@pytest.mark.parametrize("other", [Environment, VirtualTime], ids=["real time", "virtual time"])
def test_a_run_whose_clock_is_not_set_has_no_steps(
    other: type[Environment], tmp_path: Path, runtime: Path
) -> None:
    """In virtual time the recorder has other clocks than the loop."""
    with environment.within(other()):
        _, recording = run(tmp_path, stop=0.1, can=False)
    assert recording["clock_steps"] == recording["missing"] == []
    assert len(read_recording(tmp_path / "out")) == 101


def test_a_ring_of_an_earlier_version_is_saved_with_its_own_times(
    tmp_path: Path, runtime: Path
) -> None:
    ring = RingWriter(head(tmp_path))
    stamps = [START + k * TICK for k in range(10)]
    for k, stamp in enumerate(stamps):
        ring.write(k, np.zeros(ring.width))
        ring._integers[k, 1] = stamp
    key = b', "clock_offset": null'
    at = ring._memory.find(key)
    assert at > 0
    ring._memory[at : at + len(key)] = b" " * len(key)
    ring.close()
    assert len(list(rescue())) == 1
    frame: Any = read_recording(tmp_path)
    assert frame["wall_ns"].tolist() == stamps
    assert "clock steps" not in frame.attrs["stop"]
