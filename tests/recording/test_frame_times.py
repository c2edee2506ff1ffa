"""Times in the CAN log match the recording, although the kernel stamps with the wall clock."""

from __future__ import annotations

from pathlib import Path

import pytest
from clocks import MONOTONIC, Clocks, run_head
from hypothesis import given
from hypothesis import strategies as st
from loops import START, TICK
from test_can_log import READERS

from freeflyer_adapters.foundation import environment
from freeflyer_adapters.recording.can_log import FORMATS, CanLog
from freeflyer_adapters.recording.frame_times import FOLLOWED
from freeflyer_adapters.recording.recorder import Recorder
from freeflyer_adapters.recording.ring import RingReader, RingWriter
from freeflyer_adapters.recording.ring_header import CanChannel
from freeflyer_adapters.recording.wall_clock import WallClock

SECOND = 1_000_000_000
STEP = 50
"""Instants between two steps of the recorder."""


def channel(interface: str) -> CanChannel:
    return CanChannel(name="arm", interface=interface, channel="can0", is_fd=False)


def log_of(path: Path, interface: str = "socketcan") -> CanLog:
    return CanLog(channel(interface), path, WallClock(START - MONOTONIC, START))


def times(path: Path) -> list[float]:
    return [frame.timestamp for frame in READERS[path.suffix[1:]](path)]


def logged(clocks: Clocks, log: CanLog, steps: dict[int, int], count: int = 400) -> list[float]:
    """Log one frame per instant; the clock is set by `steps[k]` [ns] before instant k.

    Return the true times [s].
    """
    true = []
    for k in range(count):
        clocks.set_by += steps.get(k, 0)
        true.append(clocks.add_frame(k))
        clocks.passed += TICK
        if k % STEP == STEP - 1:
            log.take()
    log.take()
    log.close()
    return true


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("step", [-SECOND, SECOND, -20_000_000, 20_000_000, -3600 * SECOND])
def test_frames_have_the_times_of_a_clock_that_was_not_set(
    step: int, form: str, tmp_path: Path, clocks: Clocks
) -> None:
    path = tmp_path / f"can.{form}"
    true = logged(clocks, log_of(path), {220: step})
    found = times(path)
    assert found == sorted(found)
    since_the_first = [time - found[0] for time in found]
    assert since_the_first == pytest.approx([time - true[0] for time in true], abs=2e-6)
    if form == "blf":
        assert found == pytest.approx(true, abs=2e-6)


def test_the_recorders_log_has_the_times_of_its_rows(
    tmp_path: Path, runtime: Path, clocks: Clocks
) -> None:
    ring = RingWriter(run_head(tmp_path, [channel("socketcan")]))
    recorder = Recorder(RingReader(ring.path), print)
    for k in range(200):
        clocks.set_by = -SECOND if k >= 120 else 0
        clocks.add_frame(k)
        clocks.passed += TICK
        if k % STEP == STEP - 1:
            recorder.step()
    written = recorder.finish()
    ring.close()
    (path,) = written.can
    assert times(Path(path)) == pytest.approx(
        [(START + k * TICK) * 1e-9 for k in range(200)], abs=2e-6
    )
    assert len(written.clock_steps) == 1


@pytest.mark.parametrize("step", [-20_000_000, -30 * SECOND])
def test_a_clock_that_was_set_before_the_log_was_opened_is_detected(
    step: int, tmp_path: Path, clocks: Clocks
) -> None:
    clocks.passed, clocks.set_by = SECOND, step
    path = tmp_path / "can.blf"
    log = log_of(path)
    clocks.passed += 40 * TICK
    assert logged(clocks, log, {}) == pytest.approx(times(path), abs=2e-6)


@pytest.mark.parametrize("step", [-5 * SECOND, 5 * SECOND])
def test_a_clock_that_is_set_and_reset_between_two_steps_shifts_frames_by_at_most_one_step(
    step: int, tmp_path: Path, clocks: Clocks
) -> None:
    path = tmp_path / "can.blf"
    true = logged(clocks, log_of(path), {220: step, 230: -step})
    found = times(path)
    assert found == sorted(found)
    assert found == pytest.approx(true, abs=STEP * TICK * 1e-9)


def test_differences_of_a_millisecond_do_not_change_the_stamps(
    tmp_path: Path, clocks: Clocks
) -> None:
    path = tmp_path / "can.blf"
    true = logged(clocks, log_of(path), {220: 1_000_000})
    late = [time - expected for time, expected in zip(times(path), true, strict=True)]
    assert late == pytest.approx([0.0] * 220 + [1e-3] * 180, abs=2e-6)


def test_the_drift_of_a_wall_clock_is_corrected(tmp_path: Path, clocks: Clocks) -> None:
    path = tmp_path / "can.blf"
    true = logged(clocks, log_of(path), dict.fromkeys(range(400), -100000))
    found = times(path)
    assert found == sorted(found)
    assert found == pytest.approx(true, abs=(FOLLOWED + STEP * 100_000) * 1e-9 + 2e-6)


def test_stamps_of_other_interfaces_are_not_changed(tmp_path: Path, clocks: Clocks) -> None:
    path = tmp_path / "can.blf"
    true = logged(clocks, log_of(path, "pcan"), {220: SECOND})
    expected = [time + (1.0 if k >= 220 else 0.0) for k, time in enumerate(true)]
    assert times(path) == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize("step", [-SECOND, SECOND])
def test_a_frame_between_reading_the_bus_and_reading_the_clock_keeps_its_time(
    step: int, tmp_path: Path, clocks: Clocks
) -> None:
    path = tmp_path / "can.blf"
    log = log_of(path)
    frame, late = clocks.add_frame(), clocks.waiting.pop()
    clocks.passed += TICK
    clocks.set_by = step
    log.take()
    clocks.waiting.append(late)
    clocks.passed += STEP * TICK
    log.take()
    log.close()
    assert times(path) == pytest.approx([frame], abs=2e-6)


def test_frames_of_several_senders_are_sorted_by_time(tmp_path: Path, clocks: Clocks) -> None:
    """A delayed recorder reads the senders alternately, although one of them sends less often."""
    path = tmp_path / "can.blf"
    log = log_of(path)
    clocks.passed = 100 * SECOND
    true = []
    for k in range(100):
        true += [
            clocks.add_frame(k, late=(200 - k) * TICK),
            clocks.add_frame(k, late=(200 - 2 * k) * TICK),
        ]
    log.take()
    log.close()
    assert times(path) == pytest.approx(sorted(true), abs=2e-6)


@given(
    steps=st.dictionaries(st.integers(0, 7), st.tuples(st.integers(0, STEP - 1), st.integers(-5 * SECOND, 5 * SECOND)), max_size=8)
)  # fmt: skip
def test_with_one_clock_step_per_recorder_step_frames_are_sorted_and_times_nearly_exact(
    steps: dict[int, tuple[int, int]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("log") / "can.blf"
    clocks = Clocks()
    with environment.within(clocks):
        by_instant = {STEP * i + k: step for i, (k, step) in steps.items()}
        true = logged(clocks, log_of(path), by_instant)
    found = times(path)
    assert found == sorted(found)
    assert found == pytest.approx(true, abs=2.5 * FOLLOWED * 1e-9)
