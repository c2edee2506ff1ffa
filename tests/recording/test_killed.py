"""`kill -9` of the loop, of its recorder, and of both at once, at moments drawn with a seed: what is on disk afterwards."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import pytest
from loops import Loop, loop, wait_until_gone

from freeflyer.cli import main as command
from freeflyer_adapters import read_recording
from freeflyer_adapters.recording.recover import recover, unfinished
from freeflyer_adapters.recording.rescue import rescue


def moment(seed: int) -> int:
    """An instant to wait for."""
    return random.Random(seed).randrange(200, 900)


def last_stamp(made: Loop) -> int:
    """When the loop wrote its last row [ns of the wall clock]."""
    assert made.ring is not None
    return int(made.ring.last(1.0).times[-1, 0])


def flights(out: Path) -> list[Path]:
    return sorted(out.glob("flight_recording*.mcap"))


@pytest.mark.slow
def test_a_killed_loop_loses_nothing(tmp_path: Path, runtime: Path) -> None:
    with loop(tmp_path, runtime) as made:
        made.wait_for_rows(moment(1))
        recorder = made.recorder
        made.process.kill()
        made.process.wait()
        written = made.ring.written if made.ring else 0
        wait_until_gone(recorder)
        stamp = last_stamp(made)
    frame, (flight,) = (
        read_recording(tmp_path / "recording.mcap"),
        map(read_recording, flights(tmp_path)),
    )
    assert frame["instant"].tolist() == list(range(written))
    assert recover(tmp_path / "recording.mcap").path is None  # whole
    assert frame["wall_ns"].iloc[-1] == flight["wall_ns"].iloc[-1] == stamp
    assert flight.attrs["stop"]["reason"] == "the controllers' process ended without a word"
    assert list(runtime.rglob("*.ring")) == []


def test_a_killed_recorder_costs_the_end_of_the_recording_and_the_loop_writes_its_last_seconds(
    tmp_path: Path, runtime: Path
) -> None:
    with loop(tmp_path, runtime, stop=2.0) as made:
        made.wait_for_rows(moment(3))
        at = time.time_ns()
        os.kill(made.recorder, signal.SIGKILL)
        said = made.finish()
    assert made.process.returncode == 0
    assert "the recorder ended early" in said
    (flight,) = map(read_recording, flights(tmp_path))
    assert flight["instant"].iloc[-1] == 2000
    assert flight.attrs["stop"]["reason"].startswith("scenario finished")
    done = recover(tmp_path / "recording.mcap")
    assert done.path is not None
    frame = read_recording(done.path)
    assert frame["instant"].tolist() == list(range(len(frame)))
    # The loop has added what the ring still had, which was all: it is longer than the run.
    assert read_recording(tmp_path)["instant"].tolist() == list(range(2001))
    print(f"recorder killed: {(at - int(frame['wall_ns'].iloc[-1])) * 1e-9:.3f} s lost")
    assert list(runtime.rglob("*.ring")) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "held_up", [0.0, 3.0], ids=["at once", "the recorder held up for 3 s before"]
)
def test_with_both_killed_the_next_start_saves_the_last_seconds_and_nothing_is_lost(
    held_up: float, tmp_path: Path, runtime: Path
) -> None:
    """What the recorder had not written yet is in the ring, which is memory that outlives them."""
    lost = []
    for seed in (5,) if held_up else (6, 7):
        out = tmp_path / str(seed)
        with loop(out, runtime) as made:
            made.wait_for_rows(moment(seed))
            if held_up:
                os.kill(made.recorder, signal.SIGSTOP)
                made.wait_for_rows(moment(seed) + round(held_up * 1000))
            recorder = made.recorder
            for pid in (recorder, made.process.pid):
                os.kill(pid, signal.SIGKILL)
            made.process.wait()
            wait_until_gone(recorder)
            stamp = last_stamp(made)
            written = made.ring.written if made.ring else 0
        assert flights(out) == []
        (sentence,) = rescue()
        assert str(out) in sentence
        (flight,) = map(read_recording, flights(out))
        assert flight["wall_ns"].iloc[-1] == stamp
        assert flight["instant"].iloc[-1] == written - 1
        assert list(runtime.rglob("*.ring")) == []
        done = recover(out / "recording.mcap")
        assert done.end is not None
        lost.append((stamp - done.end) * 1e-9)
        frame = read_recording(out)
        assert frame["instant"].tolist() == list(range(written))
        assert not frame.isna().any().any()
        assert frame.attrs["stop"]["reason"] == "the controllers' process ended without a word"
        instants = [
            one["instant"].dropna()
            for one in (read_recording(done.path or ""), read_recording(out / "recording_2.mcap"))
        ]
        assert sum(map(len, instants)) == written  # none is twice
    print(
        f"both killed: the recorder had not written the last {', '.join(f'{each:.3f}' for each in lost)} s; all were in the ring"
    )
    assert min(lost) >= held_up


@pytest.mark.slow
def test_the_command_recovers_a_directory_with_all_that_was_left(
    tmp_path: Path, runtime: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with loop(tmp_path, runtime) as made:
        ring = made.wait_for_rows(400)
        assert command.call(["recover", str(ring.path)]) == 2  # it is somebody's
        assert "is still running" in capsys.readouterr().err
        recorder = made.recorder
        for pid in (recorder, made.process.pid):
            os.kill(pid, signal.SIGKILL)
        made.process.wait()
        wait_until_gone(recorder)
    assert len(list(unfinished(tmp_path))) == 2
    assert command.call(["recover", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "recording_recovered.mcap: kept" in said
    assert "recording_2.mcap" in said
    assert len(flights(tmp_path)) == 1
    assert command.call(["recover", str(tmp_path)]) == 0


@pytest.mark.slow
def test_ctrl_c_leaves_both_whole(tmp_path: Path, runtime: Path) -> None:
    with loop(tmp_path, runtime) as made:
        made.wait_for_rows(300)
        os.killpg(made.process.pid, signal.SIGINT)  # as a terminal does: the recorder gets it too
        said = made.finish()
    assert made.process.returncode == 3
    assert "Missing" not in said
    frame, (flight,) = (
        read_recording(tmp_path / "recording.mcap"),
        map(read_recording, flights(tmp_path)),
    )
    assert frame.attrs["stop"]["reason"].startswith(
        "interrupted by the user; all devices were brought to rest"
    )
    assert frame["instant"].iloc[-1] == flight["instant"].iloc[-1]
