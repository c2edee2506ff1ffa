"""Long recordings in parts: limited memory, no loss between parts, no part of another run."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from loops import START, TICK, head, rows
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from freeflyer_adapters import read_recording
from freeflyer_adapters.recording import parts
from freeflyer_adapters.recording.mcap_file import STOP, RecordingFile
from freeflyer_adapters.recording.parts import PART_SECONDS, PartedRecording
from freeflyer_adapters.recording.recorder import Recorder
from freeflyer_adapters.recording.recover import recover, unfinished
from freeflyer_adapters.recording.ring import RingReader, RingWriter, Rows
from freeflyer_adapters.recording.ring_recovery import rescue
from freeflyer_adapters.session import recording_lines

COUNT = 650
A_PART = 0.2


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "PART_SECONDS", A_PART)


def filled(out: Path, count: int = COUNT) -> RingWriter:
    ring = RingWriter(head(out))
    for k, line in enumerate(rows(count, ring.width).values):
        ring.write(k, line)
    return ring


def write(out: Path, count: int, started: int = START) -> list[Path]:
    made = replace(head(out), started=started)
    file = PartedRecording(made)
    for i in range(0, count, 70):
        all_rows = rows(count, made.width)
        file.add(Rows(all_rows.times[i : i + 70], all_rows.values[i : i + 70]))
    file.finish({"reason": "it was enough"})
    return file.paths


def test_parts_are_complete_files_and_together_one_table(tmp_path: Path, short: None) -> None:
    paths = write(tmp_path, COUNT)
    assert [path.name for path in paths] == [
        "recording.mcap",
        "recording_2.mcap",
        "recording_3.mcap",
        "recording_4.mcap",
    ]
    assert [len(read_recording(path)) for path in paths] == [200, 200, 200, 50]
    for path in paths:
        assert recover(path).path is None  # the file is complete
        with path.open("rb") as file:
            reader = make_reader(file)
            names = [metadata.name for metadata in reader.iter_metadata()]
            assert [attachment.name for attachment in reader.iter_attachments()] == ["origin.json"]
        assert names == ["freeflyer.run", STOP if path == paths[-1] else "freeflyer.next"]
    frame = read_recording(tmp_path)
    assert frame["instant"].tolist() == list(range(COUNT))
    assert not frame.isna().any().any()
    assert frame.attrs["stop"]["reason"] == "it was enough"
    values = rows(COUNT, head(tmp_path).width).values
    assert np.array_equal(frame["arm.joint_position[1]"], values[:, 0])
    with AnyReader(paths) as reader:
        assert (
            sum(1 for connection, _, _ in reader.messages() if connection.topic == "/loop") == COUNT
        )


def test_the_result_lists_all_parts(tmp_path: Path, runtime: Path, short: None) -> None:
    ring = filled(tmp_path)
    recorder = Recorder(RingReader(ring.path), print)
    recorder.step()
    written = recorder.finish()
    assert [Path(path).name for path in written.recording] == [
        f"recording{end}.mcap" for end in ("", "_2", "_3", "_4")
    ]
    (line,) = recording_lines({"recording": written.recording, "can": [], "flight": None})
    assert "recording.mcap" in line
    assert "recording_4.mcap" in line
    assert read_recording(tmp_path)["instant"].tolist() == list(range(COUNT))


def test_a_part_of_another_run_is_not_read(tmp_path: Path, short: None) -> None:
    write(tmp_path, COUNT)
    write(tmp_path, 250, START + 1)
    assert len(parts.parts(tmp_path)) == 4
    assert read_recording(tmp_path)["instant"].tolist() == list(range(250))


def killed(out: Path, ring: RingWriter, inject_kill: Callable[[], None]) -> None:
    """Run a recorder in a child process that is killed where `inject_kill` patches it."""
    child = os.fork()
    if not child:
        try:
            inject_kill()
            Recorder(RingReader(ring.path), print).step()
        finally:
            os._exit(1)
    assert os.waitpid(child, 0)[1] == signal.SIGKILL
    ring.close()


def kill(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def before_the_next() -> None:
    PartedRecording._change = kill  # type: ignore[method-assign]


def after_the_next() -> None:
    RecordingFile.end = kill  # type: ignore[method-assign]


def after_the_one_before() -> None:
    original = RecordingFile.end

    def end(self: RecordingFile, *arguments: object) -> None:
        original(self, *arguments)  # type: ignore[arg-type]
        kill()

    RecordingFile.end = end  # type: ignore[method-assign]


@pytest.mark.parametrize("moment", [before_the_next, after_the_next, after_the_one_before])
def test_a_kill_at_the_change_of_parts_loses_nothing(
    moment: Callable[[], None], tmp_path: Path, runtime: Path, short: None
) -> None:
    killed(tmp_path, filled(tmp_path), moment)
    (sentence,) = rescue()
    assert "and the end of its recording in" in sentence
    frame = read_recording(tmp_path)
    assert frame["instant"].tolist() == list(range(COUNT))
    assert not frame.isna().any().any()
    recovered = [recover(path) for path in unfinished(tmp_path)]
    assert all(one.kept or one.path for one in recovered)


def test_no_message_occurs_twice_in_the_recovered_file_and_the_rest(
    tmp_path: Path, runtime: Path
) -> None:
    ring = filled(tmp_path)
    reader = RingReader(ring.path)
    times = reader.everything().times[:, 0].tolist()
    recorder = Recorder(reader, print)
    recorder.step()
    (path,) = recorder.written.recording
    cut = Path(path).read_bytes()
    recorder.ring.close()
    del recorder
    Path(path).write_bytes(cut[: len(cut) * 2 // 3])
    ring.close()
    done = [recover(one) for one in unfinished(tmp_path)]
    assert done[0].rest == tmp_path / "recording_2.mcap"
    kept: list[tuple[str, int]] = []
    for one in (tmp_path / "recording_recovered.mcap", tmp_path / "recording_2.mcap"):
        with one.open("rb") as file:
            kept += [(c.topic, m.log_time) for _, c, m in make_reader(file).iter_messages()]
    assert len(kept) == len(set(kept))
    assert {time for topic, time in kept if topic == "/loop"} == set(times)


def test_the_rest_of_an_earlier_run_is_not_a_part_of_the_new_run(
    tmp_path: Path, runtime: Path
) -> None:
    ring = filled(tmp_path)
    write(tmp_path, 100, START + 1)
    ring.close()
    assert len(list(rescue())) == 1
    assert read_recording(tmp_path)["instant"].tolist() == list(range(100))
    assert read_recording(tmp_path / f"recording_of_{START}_rest.mcap")["instant"].tolist() == list(
        range(COUNT)
    )


@pytest.mark.slow
def test_memory_is_limited_by_the_size_of_a_part(tmp_path: Path) -> None:
    """Half an hour of a loop with one row per chunk, because memory grows with the chunks."""
    made = replace(head(tmp_path), tick=50 * TICK)
    one = rows(100, made.width)
    count = round(PART_SECONDS / 0.05)

    def grown(file: PartedRecording | RecordingFile, chunks: int) -> list[float]:
        sizes = [resident()]
        for _ in range(6):
            for _ in range(chunks // 100):
                file.add(one)
            sizes.append(resident())
        return sizes

    parted = grown(PartedRecording(made), count)
    with (tmp_path / "long.mcap").open("wb") as stream:
        single = grown(RecordingFile(stream, made, made.signals, 0.05), count)
    print(
        f"parts: {[round(size - parted[0], 1) for size in parted]} MiB; one file: {[round(size - single[0], 1) for size in single]} MiB"
    )
    assert parted[-1] - parted[2] < 0.3 * (single[-1] - single[2])


def resident() -> float:
    """Return the resident memory of this process [MiB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
