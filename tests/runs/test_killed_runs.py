"""Runs that SIGKILL, SIGHUP or a full disk ends, and what `freeflyer recover` makes of them."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from commands import run_command
from families import family
from run_processes import (
    ENDLESS,
    SCENARIO,
    SHORT,
    WHOLE,
    assert_first_rows,
    dead,
    done,
    endless,
    full,
    incomplete,
    killed,
    names,
    rows_in,
)

import freeflyer as ff
from freeflyer.cli import main as command
from freeflyer.foundation import output_file
from freeflyer.foundation.errors import OutputError, RecordError
from freeflyer.master.record import Record
from freeflyer.scenario import run_state, saved_run
from freeflyer.scenario.run_directory import RunDirectory
from freeflyer_adapters import run_loop


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def kill_in(place: str) -> str:
    """Return code with which a process kills itself when it calls a function."""
    module, _, name = place.partition(":")
    owner, _, attribute = name.rpartition(".")
    target = f"module.{owner}" if owner else "module"
    return f"""
import os, importlib
module = importlib.import_module({module!r})
setattr({target}, {attribute or name!r}, lambda *a, **k: os.kill(os.getpid(), 9))
"""


@pytest.mark.parametrize("engine", ["core", "python"])
def test_all_rows_of_a_killed_run_are_recovered(
    engine: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    killed(out, "--master", engine)
    rows = rows_in(out)
    (listed,) = ff.runs(tmp_path)
    assert listed.state == "incomplete"
    assert names(out) == {"unfinished"}
    with pytest.raises(RecordError, match="is not finished: its process has ended"):
        ff.open_run(out)
    code = command.call(["recover", str(out)])
    output, error = capsys.readouterr()
    assert (code, error) == (0, "")
    assert f"kept {rows} rows" in output
    assert names(out) == WHOLE
    result = ff.open_run(out)
    assert result.record.rows == rows
    assert result.verdict == "interrupted"
    assert_first_rows(result.record)


@pytest.mark.parametrize(
    "place",
    family(
        [
            "freeflyer.master.record:Record.from_rows",
            "freeflyer.foundation.output_file:_flush",
            "freeflyer.scenario.run_directory:RunDirectory._replace_if_removed",
            "freeflyer.scenario.run_directory:_renamed",
        ]
    ),
)
def test_recovery_that_is_killed_is_repeated(place: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    killed(out)
    rows = rows_in(out)
    assert done("recover", out, before=kill_in(place))[0] == -signal.SIGKILL
    assert run_state.state(out) == "incomplete"
    assert command.call(["recover", str(out)]) == 0
    assert ff.open_run(out).record.rows == rows
    assert names(out) == WHOLE


def test_a_run_that_is_killed_after_its_summary_is_finished_and_is_not_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(RunDirectory, "release", lambda _: None)
        ff.run(SCENARIO, SHORT, directory=out)
    dead(out)
    before = (out / "summary.json").read_bytes()
    assert ff.open_run(out).verdict == "completed"
    with pytest.raises(OutputError, match="not the directory of an incomplete run"):
        saved_run.complete(out)
    assert run_command(capsys, "recover", str(out))[0] == 0
    assert (out / "summary.json").read_bytes() == before
    ff.run(SCENARIO, SHORT, directory=out)
    assert (tmp_path / "out.1" / "summary.json").read_bytes() == before
    assert names(out) == WHOLE


def test_recover_takes_incomplete_runs_that_are_newer_than_the_link_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = ff.run(SCENARIO, SHORT)
    first = result.save()
    link = first.with_name(SCENARIO)
    newer = [first.with_name(f"{SCENARIO}-{year}0101-000000-00000000") for year in (3000, 3001)]
    for path in newer:
        incomplete(path)
    assert link.resolve() == first.resolve()
    code, _ = run_command(capsys, "recover", str(link))
    assert code == 0
    for path in newer:
        assert names(path) == WHOLE
        assert ff.open_run(path).record.digest == result.record.digest
    # The link leads to the newest finished run, also to a completed one, but not to an older one.
    assert os.readlink(link) == newer[1].name
    older = first.with_name(f"{SCENARIO}-20000101-000000-00000000")
    incomplete(older)
    assert run_command(capsys, "recover", str(older))[0] == 0
    assert os.readlink(link) == newer[1].name


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM])
def test_a_signal_ends_a_run_with_its_results(number: int, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with endless(out) as process:
        process.send_signal(number)
        process.communicate(timeout=60)
        assert process.returncode == 3
    assert names(out) == WHOLE
    result = ff.open_run(out)
    assert result.verdict == "interrupted"
    assert_first_rows(result.record)


def test_a_directory_that_is_removed_during_a_run_is_replaced_and_not_mixed(
    tmp_path: Path,
) -> None:
    """SIGHUP ends the run."""
    out = tmp_path / "out"
    with endless(out) as process:
        shutil.rmtree(out)
        other = ff.run(SCENARIO, SHORT, directory=out)
        before = (out / "summary.json").read_bytes()
        process.send_signal(signal.SIGHUP)
        output, _ = process.communicate(timeout=60)
        assert process.returncode == 3
    assert "removed or renamed during the run; the results are in" in output
    assert (out / "summary.json").read_bytes() == before
    assert ff.open_run(out).record.digest == other.record.digest
    assert_first_rows(ff.open_run(tmp_path / "out.1").record)
    assert names(out) == names(tmp_path / "out.1") == WHOLE


def test_a_removed_directory_that_another_run_holds_is_not_touched(tmp_path: Path) -> None:
    """The new folder may have the inode of the removed one."""
    out = tmp_path / "out"
    mine = RunDirectory.claim(out)
    shutil.rmtree(out)
    other = RunDirectory.claim(out)
    mine.abandon()
    assert run_state.state(out) == "running"
    with other:
        other.begin()
        other.finish({}, {"run": "other"})
    assert names(out) == {"summary.json"}


def test_after_a_full_disk_at_the_end_the_run_is_completed_later_also_in_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(Record, "write_file", full)
        with pytest.raises(OutputError, match=r"No space left.*freeflyer recover") as raised:
            ff.run(SCENARIO, SHORT, directory=out)
    assert raised.value.exit_code == 3
    assert run_state.state(out) == "incomplete"
    with pytest.raises(OutputError, match="incomplete run"):
        ff.run(SCENARIO, SHORT, directory=out)
    saved_run.complete(out)
    result = ff.open_run(out)
    assert result.verdict == "completed"
    assert result.record.digest == ff.run(SCENARIO, SHORT).record.digest
    assert names(out) == WHOLE


def test_a_result_that_cannot_be_saved_leaves_the_earlier_run_and_can_be_saved_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result, out = ff.run(SCENARIO, SHORT), tmp_path / "out"
    result.save(out)
    before = (out / "summary.json").stat().st_ino
    for name in ("record.parquet", "summary.json"):
        with monkeypatch.context() as patch:
            patch.setattr(
                output_file, "_flush", lambda path, name=name: name in str(path) and full()
            )
            with pytest.raises(OutputError, match="No space left"):
                result.save(out)
        assert names(tmp_path) == {"out"}
        assert names(out) == WHOLE
        assert (out / "summary.json").stat().st_ino == before
    result.save(out)
    assert names(tmp_path) == {"out", "out.1"}


def test_a_disk_without_space_for_the_rows_is_reported_before_the_run(tmp_path: Path) -> None:
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, {resource.RLIM_INFINITY}))"
    out = tmp_path / "out"
    code, _, error = done("run", SCENARIO, *ENDLESS, "--out", out, before=limit)
    assert (code, len(error.splitlines())) == (2, 1)
    assert "GiB; increase [record] every_s or reduce stop_s" in error
    assert not out.exists()


@pytest.mark.slow
def test_a_disk_that_becomes_full_during_the_run_keeps_all_rows(tmp_path: Path) -> None:
    """On a file system of its own, which another file fills during the run."""
    space = tmp_path / "space"
    space.mkdir()
    mount = f"mount -t tmpfs -o size=40m none {space}"
    if subprocess.run(["unshare", "-Urm", "sh", "-c", mount], capture_output=True).returncode:
        pytest.skip("no file system can be mounted here")
    code = f"""
import sys, signal
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from run_processes import endless, done, names, assert_first_rows
import freeflyer as ff
out = Path({str(space)!r}, "out")
with endless(out, "--set", "stop_s=800") as process:
    fill = out.parent / "fill"
    try:
        with fill.open("wb") as file:
            while True:
                file.write(bytes(4096)); file.flush()
    except OSError:
        pass
    process.send_signal(signal.SIGTERM)
    output, error = process.communicate(timeout=60)
    assert process.returncode == 3, (output, error)
    assert "No space left" in error and len(error.splitlines()) == 1, error
code, _, error = done("recover", out)
assert code in (2, 3) and len(error.splitlines()) == 1 and "No space left" in error, error
fill.unlink()
assert done("recover", out)[0] == 0
assert names(out) == {{"record.parquet", "summary.json"}}, names(out)
assert_first_rows(ff.open_run(out).record)
"""
    done_ = subprocess.run(
        ["unshare", "-Urm", "sh", "-c", f'{mount} && exec "$@"', "sh", sys.executable, "-c", code],
        capture_output=True,
        text=True,
    )
    assert done_.returncode == 0, done_.stderr


def test_the_loop_makes_no_system_call_for_its_rows(tmp_path: Path) -> None:
    """/proc/self/io counts the write system calls of the process."""
    if not Path("/proc/self/io").exists():
        pytest.skip("/proc/self/io does not exist")
    counts: list[int] = []

    def count(_: float) -> None:
        text = Path("/proc/self/io").read_text()
        counts.append(int(text.partition("syscw: ")[2].split()[0]))

    ff.run(SCENARIO, {"stop_s": 30}, directory=tmp_path / "out", progress=count)  # fmt: skip
    assert len(counts) > 3
    assert counts[0] == counts[-1]


def test_a_summary_that_is_written_belongs_to_the_record_beside_it(tmp_path: Path) -> None:
    ff.run(SCENARIO, SHORT, directory=tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (
        summary["run"]["record_sha256"] == Record.read(tmp_path / "out" / "record.parquet").digest
    )


@pytest.mark.slow
def test_a_run_with_devices_that_cannot_be_written_releases_its_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, quiet = tmp_path / "out", lambda _: None
    with monkeypatch.context() as patch:
        patch.setattr(Record, "write_file", full)
        with pytest.raises(OutputError, match="No space left"):
            run_loop("facility", {"stop_s": 0.1}, directory=out, virtual=True, show=quiet)
    assert run_state.state(out) == "incomplete"
    assert command.call(["recover", str(out)]) == 0
    (found,) = ff.runs(out)
    assert (found.state, run_state.state(out)) == ("interrupted", "finished")
    assert ff.open_run(out).record.rows >= 9  # from its recording
    run_loop("facility", {"stop_s": 0.1}, directory=out, virtual=True, show=quiet)
    assert names(tmp_path) == {"out", "out.1"}
