"""Recordings of real-time loops: complete; faults of disk or recorder do not affect the loop."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from families import family
from loops import head
from mcap.reader import make_reader

from freeflyer.cli import main as command
from freeflyer.foundation.errors import OutputError
from freeflyer.scenario import scenario
from freeflyer_adapters import read_recording
from freeflyer_adapters.loop import hil
from freeflyer_adapters.recording.client import Recording, RecordingClient
from freeflyer_adapters.recording.mcap_file import FLIGHT_SECONDS
from freeflyer_adapters.recording.recorder import Recorder
from freeflyer_adapters.recording.recover import recover
from freeflyer_adapters.recording.ring import RingReader, RingWriter

STOP = 3.0
EXTENDS = 'extends = "facility"\n'


def run(
    folder: Path, text: str = "", stop: float = STOP, **options: Any
) -> tuple[Any, dict[str, Any]]:
    path = folder / "changed.toml"
    path.write_text(EXTENDS + text)
    chosen = scenario.load(str(path), [f"stop_s={stop}"])
    out = folder / "out"
    out.mkdir(exist_ok=True)
    result, report = hil.run(
        chosen,
        simulated=True,
        recording=Recording(directory=out, **options),
        show=lambda text: None,
    )
    assert report.recording is not None
    return result, dict(report.recording)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Any, dict[str, Any], Path]]:
    folder = tmp_path_factory.mktemp("whole")
    result, recording = run(folder)
    return result, recording, folder / "out"


def test_a_recording_has_every_instant_and_equals_the_record_of_the_run(
    whole: tuple[Any, dict[str, Any], Path],
) -> None:
    result, recording, out = whole
    assert recording["missing"] == []
    assert recording["rows_lost"] == 0
    frame = read_recording(out / "recording.mcap")
    assert frame["instant"].tolist() == list(range(round(STOP * 1000) + 1))
    assert (frame["wall_ns"].astype(np.int64).diff().dropna() > 0).all()
    record = result.outcome.record
    every = frame.iloc[::10]
    assert np.array_equal(every["time"], record.time)
    for one in record.signals.values():
        assert np.array_equal(
            every[one.columns].to_numpy(), record[one.name].reshape(len(every), -1)
        ), one.name
    units = record.units
    assert all(frame.attrs["units"][column] == unit for column, unit in units.items())
    assert (frame["arm_drive: state"] == 2.0).all()


def test_the_flight_recording_has_the_last_two_seconds_of_every_signal(
    whole: tuple[Any, dict[str, Any], Path],
) -> None:
    _, recording, out = whole
    frame, flight = read_recording(out / "recording.mcap"), read_recording(recording["flight"])
    assert flight["monotonic_ns"].iloc[-1] - flight["monotonic_ns"].iloc[0] == pytest.approx(
        FLIGHT_SECONDS * 1e9, rel=0.05
    )
    assert np.array_equal(flight.to_numpy(), frame[flight.columns].tail(len(flight)).to_numpy())
    assert flight.attrs["stop"]["reason"].startswith(
        "scenario finished; all devices were brought to rest"
    )
    assert flight.attrs["stop"]["rows lost by the recorder"] == "0"


def test_signals_of_the_scenario_are_recorded_as_ros_messages(
    whole: tuple[Any, dict[str, Any], Path],
) -> None:
    _, _, out = whole
    with (out / "recording.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    found = {
        channel.topic: summary.schemas[channel.schema_id].name
        for channel in summary.channels.values()
    }
    expected = {
        "/arm_drive/joint_states": "sensor_msgs/msg/JointState",  # measured
        "/manipulator_controller/joint_states": "sensor_msgs/msg/JointState",  # commanded
        "/base_robot/base/odometry": "nav_msgs/msg/Odometry",  # measured
        "/satellite/base/odometry": "nav_msgs/msg/Odometry",  # set point
        "/hand_kinematics/end_effector/pose": "geometry_msgs/msg/PoseStamped",
        "/hand_kinematics/end_effector/twist": "geometry_msgs/msg/TwistStamped",
        "/reference_trajectory/pose": "geometry_msgs/msg/PoseStamped",
        "/reference_trajectory/twist": "geometry_msgs/msg/TwistStamped",
        "/base_controller/base/wrench": "geometry_msgs/msg/WrenchStamped",
    }
    assert expected.items() <= found.items()


@pytest.mark.slow
def test_the_recording_has_the_chosen_signals_and_the_flight_recording_has_all(
    tmp_path: Path, runtime: Path
) -> None:
    run(tmp_path, '[record]\nsignals = ["satellite.*"]\n', stop=0.2)
    chosen, flight = (
        read_recording(tmp_path / "out" / "recording.mcap"),
        read_recording(tmp_path / "out" / "flight_recording.mcap"),
    )
    assert "satellite.base_acceleration[1]" in chosen
    assert "base_robot.base_position[1]" in chosen  # an error signal needs it
    assert "base_controller.base_wrench[1]" not in chosen
    assert "base_controller.base_wrench[1]" in flight
    assert len(chosen) == len(flight) == 201


def test_the_last_row_and_the_reason_contain_the_exceeded_limit(
    tmp_path: Path, runtime: Path
) -> None:
    limit = '[[limits]]\nsignal = "base_controller.base_wrench"\nmaximum = 0.05\ncause = "the force is too large [N]"\n'
    result, recording = run(tmp_path, limit)
    flight = read_recording(recording["flight"])
    assert flight.attrs["stop"]["reason"].startswith(
        "the force is too large [N]: base_controller.base_wrench is"
    )
    wrench = np.abs(
        flight[[f"base_controller.base_wrench[{i + 1}]" for i in range(6)]].to_numpy()
    ).max(axis=1)
    assert wrench[-1] > 0.05
    assert (wrench[:-1] <= 0.05).all()
    assert flight["time"].iloc[-1] == pytest.approx(result.outcome.simulated)


def test_without_a_recording_the_flight_recording_is_still_written(
    tmp_path: Path, runtime: Path
) -> None:
    _, recording = run(tmp_path, stop=0.2, everything=False)
    assert recording["recording"] == []
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["flight_recording.mcap"]
    assert list(runtime.rglob("*.ring")) == []


@pytest.mark.slow
def test_an_unfinished_recording_of_an_earlier_run_is_not_overwritten(
    tmp_path: Path, runtime: Path
) -> None:
    out, data = tmp_path / "out", b"\x89MCAP0\r\n and no end"
    out.mkdir()
    (out / "recording.mcap").write_bytes(data)
    arguments = ["hil", "facility", "--accelerated", "--set", "stop_s=0.1", "--out", str(out)]
    assert command.call(arguments) == 2
    assert [path.read_bytes() for path in out.iterdir()] == [data]
    assert command.call([*arguments, "--keep"]) == 0
    assert (tmp_path / "out.1" / "recording.mcap").read_bytes() == data
    assert command.call(arguments) == 0  # a finished run is renamed
    assert (tmp_path / "out.2" / "recording.mcap").read_bytes() != data


@contextlib.contextmanager
def while_it_runs(
    monkeypatch: pytest.MonkeyPatch, acts: dict[int, Callable[[RecordingClient], object]]
) -> Iterator[None]:
    """Calls `acts[k](client)` at instant k."""
    original = RecordingClient.write

    def write(self: RecordingClient, k: int) -> None:
        original(self, k)
        if k in acts:
            acts[k](self)

    monkeypatch.setattr(RecordingClient, "write", write)
    yield


def signalled(number: int) -> Callable[[RecordingClient], None]:
    def act(client: RecordingClient) -> None:
        assert client.recorder is not None
        os.kill(client.recorder, number)

    return act


@pytest.mark.slow
def test_a_deleted_directory_is_reported_and_the_loop_continues(
    tmp_path: Path,
    runtime: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    with while_it_runs(monkeypatch, {300: lambda client: shutil.rmtree(tmp_path / "out")}):
        result, recording = run(tmp_path, stop=0.8)
    assert result.as_expected
    assert result.outcome.simulated == 0.8
    assert "the recording is incomplete: No such file or directory" in recording["missing"]
    lines = capfd.readouterr().err.splitlines()
    assert sum("the loop continues" in line for line in lines) == 1
    # The directory is created again for the last seconds.
    assert read_recording(recording["flight"])["instant"].iloc[-1] == 800


@pytest.mark.parametrize(
    "for_all", family([False, True]), ids=["for the recorder", "for the loop too"]
)
def test_a_full_disk_is_reported_once_and_the_written_part_is_kept(
    for_all: bool,
    tmp_path: Path,
    runtime: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """The files of the recorder are limited to half a megabyte."""

    def fill(client: RecordingClient) -> None:
        assert client.recorder is not None
        resource.prlimit(client.recorder, resource.RLIMIT_FSIZE, (500_000, resource.RLIM_INFINITY))

    def full(*arguments: object) -> None:
        raise OutputError("no room")

    if for_all:
        monkeypatch.setattr("freeflyer_adapters.recording.client.save_flight", full)
    with while_it_runs(monkeypatch, {50: fill}):
        result, recording = run(tmp_path, stop=1.0)
    assert result.as_expected
    assert [
        text
        for text in recording["missing"]
        if "the recording is incomplete: File too large" in text
    ]
    lines = capfd.readouterr().err.splitlines()
    assert sum("the recording has stopped" in line for line in lines) == 1
    frame = read_recording(tmp_path / "out" / "recording.mcap")
    assert frame["instant"].tolist() == list(range(len(frame)))
    assert 100 < len(frame) < 1000
    rings = list(runtime.rglob("*.ring"))
    if not for_all:
        flight = read_recording(recording["flight"])
        assert flight["instant"].tolist() == list(range(1001))
        assert flight.attrs["stop"]["written by"] == "the loop, without its recorder"
        assert rings == []
        return
    # The last seconds remain in the ring, and the result contains the command that saves them.
    assert recording["flight"] is None
    (ring,) = rings
    assert f"`freeflyer recover {ring}`" in " ".join(recording["missing"])
    assert recover(ring).path is not None
    assert list(runtime.rglob("*.ring")) == []


@pytest.mark.slow
def test_a_suspended_recorder_loses_nothing_and_does_not_block_the_loop(
    tmp_path: Path, runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The recorder is suspended until near the end, which a blocked loop would not reach."""
    with while_it_runs(
        monkeypatch, {200: signalled(signal.SIGSTOP), 990: signalled(signal.SIGCONT)}
    ):
        result, recording = run(tmp_path, stop=1.0)
    assert result.as_expected
    assert recording["rows_lost"] == 0
    assert read_recording(tmp_path / "out" / "recording.mcap")["instant"].tolist() == list(
        range(1001)
    )


@pytest.mark.slow
def test_a_recorder_that_is_suspended_longer_than_the_ring_counts_the_lost_rows(
    tmp_path: Path, runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("freeflyer_adapters.recording.ring.SECONDS", 0.3)
    with while_it_runs(
        monkeypatch, {200: signalled(signal.SIGSTOP), 990: signalled(signal.SIGCONT)}
    ):
        result, recording = run(tmp_path, stop=1.0)
    assert result.as_expected
    frame = read_recording(tmp_path / "out" / "recording.mcap")
    assert recording["rows_lost"] > 300
    assert len(frame) + recording["rows_lost"] == 1001
    assert frame.attrs["stop"]["rows lost by the recorder"] == str(recording["rows_lost"])


def test_a_recorder_that_cannot_start_is_reported_and_the_loop_writes_its_last_seconds(
    tmp_path: Path, runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.executable", "/bin/false")
    result, recording = run(tmp_path, stop=0.3)
    assert result.as_expected
    assert any("recorder has not started" in text for text in recording["missing"])
    flight = read_recording(recording["flight"])
    assert flight["instant"].tolist() == list(range(301))
    assert flight.attrs["stop"]["written by"] == "the loop, without its recorder"
    assert list(runtime.rglob("*.ring")) == []


def test_if_the_directory_cannot_be_written_the_last_seconds_go_to_a_temporary_directory(
    tmp_path: Path, runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(elsewhere))
    (tmp_path / "file").write_text("")
    ring = RingWriter(head(tmp_path / "file" / "out"))
    for k in range(10):
        ring.write(k, np.zeros(ring.width))
    messages: list[str] = []
    recorder = Recorder(RingReader(ring.path), messages.append)
    recorder.step()
    written = recorder.finish()
    assert written.recording == []
    assert len(messages) == 1
    assert written.flight is not None
    assert Path(written.flight).is_relative_to(elsewhere)
    assert len(read_recording(written.flight)) == 10
