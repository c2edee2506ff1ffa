"""Files after `kill -9` of the loop, its recorder or both, at random instants with a seed."""

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
from freeflyer_adapters.recording.ring_recovery import rescue


def moment(seed: int) -> int:
    """Return the instant of the kill."""
    return random.Random(seed).randrange(200, 900)


def last_stamp(made: Loop) -> int:
    """Return the wall time of the last row [ns]."""
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
    assert recover(tmp_path / "recording.mcap").path is None  # the file is complete
    assert frame["wall_ns"].iloc[-1] == flight["wall_ns"].iloc[-1] == stamp
    assert (
        flight.attrs["stop"]["reason"] == "the controllers' process ended without a reported reason"
    )
    assert list(runtime.rglob("*.ring")) == []


def test_after_a_killed_recorder_the_loop_writes_the_last_seconds_and_the_rest_of_the_ring(
    tmp_path: Path, runtime: Path
) -> None:
    with loop(tmp_path, runtime, stop=2.0) as made:
        made.wait_for_rows(moment(3))
        at = time.time_ns()
        os.kill(made.recorder, signal.SIGKILL)
        output = made.finish()
    assert made.process.returncode == 0
    assert "the recorder ended early" in output
    (flight,) = map(read_recording, flights(tmp_path))
    assert flight["instant"].iloc[-1] == 2000
    assert flight.attrs["stop"]["reason"].startswith("scenario finished")
    done = recover(tmp_path / "recording.mcap")
    assert done.path is not None
    frame = read_recording(done.path)
    assert frame["instant"].tolist() == list(range(len(frame)))
    # The ring is longer than this run, so the loop could write all missing rows.
    assert read_recording(tmp_path)["instant"].tolist() == list(range(2001))
    print(f"recorder killed: {(at - int(frame['wall_ns'].iloc[-1])) * 1e-9:.3f} s lost")
    assert list(runtime.rglob("*.ring")) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "suspended", [0.0, 3.0], ids=["at once", "the recorder suspended for 3 s before"]
)
def test_with_both_killed_the_next_start_saves_the_last_seconds_and_nothing_is_lost(
    suspended: float, tmp_path: Path, runtime: Path
) -> None:
    """The ring contains the rows that the recorder had not written."""
    lost = []
    for seed in (5,) if suspended else (6, 7):
        out = tmp_path / str(seed)
        with loop(out, runtime) as made:
            made.wait_for_rows(moment(seed))
            if suspended:
                os.kill(made.recorder, signal.SIGSTOP)
                made.wait_for_rows(moment(seed) + round(suspended * 1000))
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
        assert (
            frame.attrs["stop"]["reason"]
            == "the controllers' process ended without a reported reason"
        )
        instants = [
            one["instant"].dropna()
            for one in (read_recording(done.path or ""), read_recording(out / "recording_2.mcap"))
        ]
        assert sum(map(len, instants)) == written  # no instant occurs twice
    print(
        f"both killed: the recorder had not written the last {', '.join(f'{each:.3f}' for each in lost)} s; the ring contained all of it"
    )
    assert min(lost) >= suspended


@pytest.mark.slow
def test_the_command_recovers_all_files_of_a_directory(
    tmp_path: Path, runtime: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with loop(tmp_path, runtime) as made:
        ring = made.wait_for_rows(400)
        assert command.call(["recover", str(ring.path)]) == 2  # its loop is running
        assert "is still running" in capsys.readouterr().err
        recorder = made.recorder
        for pid in (recorder, made.process.pid):
            os.kill(pid, signal.SIGKILL)
        made.process.wait()
        wait_until_gone(recorder)
    assert len(list(unfinished(tmp_path))) == 2
    assert command.call(["recover", str(tmp_path)]) == 0
    output = capsys.readouterr().out
    assert "recording_recovered.mcap: kept" in output
    assert "recording_2.mcap" in output
    assert len(flights(tmp_path)) == 1
    assert command.call(["recover", str(tmp_path)]) == 0


@pytest.mark.slow
def test_after_ctrl_c_both_files_are_complete(tmp_path: Path, runtime: Path) -> None:
    with loop(tmp_path, runtime) as made:
        made.wait_for_rows(300)
        os.killpg(made.process.pid, signal.SIGINT)  # as a terminal does: also to the recorder
        output = made.finish()
    assert made.process.returncode == 3
    assert "Missing" not in output
    frame, (flight,) = (
        read_recording(tmp_path / "recording.mcap"),
        map(read_recording, flights(tmp_path)),
    )
    assert frame.attrs["stop"]["reason"].startswith(
        "interrupted by the user; all devices were brought to rest"
    )
    assert frame["instant"].iloc[-1] == flight["instant"].iloc[-1]
