"""Directories of runs: what happens to their content, and places that cannot be used."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from commands import run_command
from run_processes import SCENARIO, SHORT, WHOLE, dead, endless, incomplete, names

import freeflyer as ff
from freeflyer.foundation.errors import OutputError
from freeflyer.scenario import run_state, saved_run
from freeflyer.scenario.run_directory import RunDirectory
from freeflyer.scenario.run_state import state

SET = ("--set", "stop_s=0.5")


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def put(directory: Path, content: str) -> None:
    """Make a directory: empty, or with a finished run, an incomplete run or other files."""
    if content == "finished":
        ff.run(SCENARIO, SHORT).save(directory)
        (directory / "energy_audit.json").write_text("{}")
    elif content == "incomplete":
        incomplete(directory)
    elif content == "other":
        directory.mkdir()
        (directory / "notes.txt").write_text("mine")
    elif content == "empty":
        directory.mkdir()


@pytest.mark.parametrize("existing", [None, "keep", "overwrite"])
@pytest.mark.parametrize("content", ["missing", "empty", "finished", "incomplete", "other"])
def test_what_happens_to_the_content_of_a_directory(
    content: str, existing: Any, tmp_path: Path
) -> None:
    """docs/runs.md has the table."""
    out, aside = tmp_path / "out", tmp_path / "out.1"
    put(out, content)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    if existing is None and content in ("incomplete", "other"):
        with pytest.raises(OutputError, match="choose another directory, or rename it") as raised:
            ff.run(SCENARIO, SHORT, directory=out)
        assert raised.value.exit_code == 2
        assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
        return
    result = ff.run(SCENARIO, SHORT, directory=out, existing=existing)
    kept = existing == "keep" or (existing is None and content == "finished")
    more = {"notes.txt"} if content == "other" and existing == "overwrite" else set()
    assert names(out) == WHOLE | more
    assert ff.open_run(out).record.digest == result.record.digest
    if kept and before:
        assert {path.name: path.read_bytes() for path in aside.rglob("*") if path.is_file()} == {
            path.name: data for path, data in before.items()
        }
        assert state(aside) == content
    else:
        assert not aside.exists()


def test_a_directory_in_use_is_rejected_in_every_way(tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "out"
    with endless(out) as process:
        before = names(out)
        for options in ([], ["--keep"], ["--overwrite"]):
            code, error = run_command(capsys, "run", SCENARIO, *SET, "--out", str(out), *options)
            assert code == 2
            assert f"in use by process {process.pid}" in error
        assert run_command(capsys, "recover", str(out))[0] == 2
        assert run_command(capsys, "audit", str(out))[0] == 2
        assert run_command(capsys, "run", str(out))[0] == 2
        assert names(out) == before
        (listed,) = ff.runs(tmp_path)
        assert listed.state == "running"
        assert process.poll() is None


def unprivileged() -> int | None:
    """Return the number of a user without the rights of root, or None if this is such a user."""
    return 65534 if os.geteuid() == 0 else None


@pytest.mark.parametrize("place", ["read-only", "of another user"])
def test_a_directory_that_cannot_be_written_is_rejected_before_the_run(
    place: str, tmp_path: Path
) -> None:
    if place == "of another user" and unprivileged() is None:
        pytest.skip("only root can create directories of other users")
    # pytest's own folders belong to one user.
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    out = folder / "out"
    put(out, "finished")
    if unprivileged() is not None:
        os.chown(out, *(2 * (0 if place == "of another user" else 65534,)))
    out.chmod(0o555 if place == "read-only" else 0o755)
    code = f"""
import os, sys
from freeflyer.foundation.errors import OutputError
from freeflyer.scenario.run_directory import RunDirectory
if {unprivileged()!r}:
    os.setgid({unprivileged()!r}); os.setuid({unprivileged()!r})
for existing in (None, "keep", "overwrite"):
    try:
        RunDirectory.claim(__import__("pathlib").Path({str(out)!r}), existing)
    except OutputError as error:
        assert error.exit_code == 2, error
        assert "Permission denied" in str(error), error
    else:
        raise AssertionError(existing)
"""
    try:
        ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd="/")  # fmt: skip
        assert ended.returncode == 0, ended.stderr
        assert names(folder) == {"out"}
        assert names(out) == {*WHOLE, "energy_audit.json"}
    finally:
        out.chmod(0o755)
        shutil.rmtree(folder)


def test_a_file_or_a_link_in_place_of_a_directory_is_rejected(tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "file").write_text("mine")
    put(tmp_path / "elsewhere", "finished")
    (tmp_path / "link").symlink_to("elsewhere")
    (tmp_path / "dangling").symlink_to("nowhere")
    before = names(tmp_path)
    for name, reason in {
        "file": "file is not a directory",
        "file/out": "file is not a directory",
        "link": "it is a symbolic link to elsewhere",
        "dangling": "dangling is not a directory",
        "dangling/out": "dangling is not a directory",
        "x" * 300: "File name too long",
    }.items():
        for options in ([], ["--keep"], ["--overwrite"]):
            code, error = run_command(capsys, "run", SCENARIO, *SET, "--out", name, *options)
            assert (code, reason in error) == (2, True), error
    assert names(tmp_path) == before
    assert names(tmp_path / "elsewhere") == {*WHOLE, "energy_audit.json"}


@pytest.mark.parametrize("kind", ["file", "dangling link"])
def test_a_default_folder_that_is_no_folder_is_rejected(
    kind: str, tmp_path: Path, capsys: Any
) -> None:
    place = tmp_path / "freeflyer_out"
    place.symlink_to("nowhere") if kind == "dangling link" else place.write_text("mine")
    code, error = run_command(capsys, "run", SCENARIO, *SET)
    assert code == 2
    assert "freeflyer_out is not a directory" in error


def link_of(tmp_path: Path) -> Path:
    return tmp_path / "freeflyer_out" / SCENARIO


def test_a_directory_of_an_earlier_version_is_renamed_and_the_link_follows_the_newest_run(
    tmp_path: Path,
) -> None:
    link = link_of(tmp_path)
    link.mkdir(parents=True)
    (link / "summary.json").write_text("{}")
    result = ff.run(SCENARIO, SHORT)
    first = result.save()
    assert (link.with_name(f"{SCENARIO}.1") / "summary.json").read_text() == "{}"
    assert os.readlink(link) == first.name
    second = result.save()
    assert second != first
    assert os.readlink(link) == second.name
    assert names(first) == WHOLE
    shutil.rmtree(second)
    third = result.save()
    assert os.readlink(link) == third.name


@pytest.mark.parametrize("target", ["../elsewhere", "absolute", "directory", "file"])
def test_what_the_user_has_put_in_place_of_the_link_stays(target: str, tmp_path: Path) -> None:
    link = link_of(tmp_path)
    link.parent.mkdir()
    if target == "directory":
        link.mkdir()
        (link / "notes.txt").write_text("mine")
    elif target == "file":
        link.write_text("mine")
    else:
        (tmp_path / "elsewhere").mkdir()
        link.symlink_to(tmp_path / "elsewhere" if target == "absolute" else target)
    before = os.lstat(link).st_ino
    claimed = RunDirectory.unique(SCENARIO, "")
    with claimed:
        claimed.begin()
        claimed.finish({}, {})
    assert os.lstat(link).st_ino == before
    assert any("stays as it is" in line for line in claimed.lines)
    assert names(claimed.path) == {"summary.json"}
    assert names(link.parent) == {SCENARIO, claimed.path.name}


def test_runs_that_begin_in_the_same_second_have_directories_of_their_own() -> None:
    claims = [RunDirectory.unique("same", "text") for _ in range(3)]
    assert len({claimed.path for claimed in claims}) == 3
    for claimed in claims:
        claimed.abandon()
    assert os.listdir("freeflyer_out") == [] if os.path.exists("freeflyer_out") else True


def test_a_run_that_does_not_begin_leaves_everything_as_it_was(tmp_path: Path, capsys: Any) -> None:
    bad = ("run", SCENARIO, "--set", "free_flyer.base_mass=-5")
    assert run_command(capsys, *bad)[0] == 2
    assert run_command(capsys, *bad, "--out", "some/where/out")[0] == 2
    assert names(tmp_path) == set()
    put(tmp_path / "out", "finished")
    before = (tmp_path / "out" / "summary.json").stat()
    for options in ([], ["--keep"], ["--overwrite"]):
        assert run_command(capsys, *bad, "--out", "out", *options)[0] == 2
    assert names(tmp_path) == {"out"}
    assert (tmp_path / "out" / "summary.json").stat() == before
    assert names(tmp_path / "out") == {*WHOLE, "energy_audit.json"}


def test_directories_with_unusual_names_are_directories_of_runs(tmp_path: Path) -> None:
    for name in ("unfinished", "[a]*?", "a b\n'\"", "\udcff"):
        out = tmp_path / name
        first = ff.run(SCENARIO, SHORT, directory=out)
        ff.run(SCENARIO, SHORT, directory=out)
        assert names(out) == names(tmp_path / f"{name}.1") == WHOLE
        assert ff.open_run(out).record.digest == first.record.digest


def test_a_directory_on_another_file_system(tmp_path: Path) -> None:
    memory = Path("/dev/shm")
    if not memory.is_dir() or memory.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("there is no second file system")
    folder = Path(tempfile.mkdtemp(dir=memory))
    try:
        for _ in range(2):
            ff.run(SCENARIO, SHORT, directory=folder / "out")
        assert names(folder) == {"out", "out.1"}
    finally:
        shutil.rmtree(folder)


def test_a_process_of_another_machine_counts_as_running_and_its_number_is_not_trusted(
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    RunDirectory.claim(out)
    path = out / "unfinished" / "process.json"
    found = json.loads(path.read_text())
    path.write_text(json.dumps({**found, "host": "elsewhere x y"}))
    with pytest.raises(OutputError, match="on elsewhere, or that process has ended: remove"):
        RunDirectory.claim(out, "overwrite")
    # The number of this process, but another start time: it was used again.
    path.write_text(json.dumps({**found, "started": "1"}))
    assert state(out) == "incomplete"
    assert run_state.owner(out) is None
    dead(out)
    RunDirectory.claim(out, "keep")


@pytest.mark.slow
def test_an_audit_stands_only_beside_its_own_record(tmp_path: Path, capsys: Any) -> None:
    one = ff.run(SCENARIO, {"stop_s": 1}, directory=tmp_path / "one")
    ff.run(SCENARIO, {"stop_s": 0.9}, directory=tmp_path / "two")
    done = ff.audit(one)
    with pytest.raises(OutputError, match="has the record of another run"):
        done.write(tmp_path / "two")
    assert names(tmp_path / "two") == WHOLE
    done.write(tmp_path / "one")
    audited = json.loads((tmp_path / "one" / "energy_audit.json").read_text())
    assert audited["record_sha256"] == one.record.digest
    ff.run(SCENARIO, {"stop_s": 0.9}, directory=tmp_path / "one", existing="overwrite")
    assert names(tmp_path / "one") == WHOLE


def test_an_audit_is_not_written_beside_a_record_that_has_replaced_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run is replaced while the figure is drawn."""
    from freeflyer.scenario import figure_style

    out = tmp_path / "out"
    done = ff.audit(ff.run(SCENARIO, {"stop_s": 1}, directory=out))

    def replace(*_: object) -> None:
        ff.run(SCENARIO, {"stop_s": 0.9}, directory=out, existing="overwrite")

    monkeypatch.setattr(figure_style, "save", replace)
    monkeypatch.setattr(type(done), "plot", lambda _: None)
    with pytest.raises(OutputError, match="has the record of another run"):
        done.write(out)
    assert names(out) == WHOLE


def test_an_audit_is_not_written_to_an_incomplete_run_and_does_not_stay_in_a_recovered_one(
    tmp_path: Path,
) -> None:
    """The run was killed after it had removed the audited record."""
    out = tmp_path / "out"
    done = ff.audit(ff.run(SCENARIO, {"stop_s": 1}))
    incomplete(out)
    with pytest.raises(OutputError, match="it has an incomplete run") as raised:
        done.write(out)
    assert raised.value.exit_code == 2
    (out / "energy_audit.json").write_text("{}")  # a moment earlier
    saved_run.complete(out)
    assert names(out) == WHOLE


def test_the_current_directory_is_used_if_it_is_empty_and_is_not_renamed(
    tmp_path: Path, capsys: Any
) -> None:
    for _ in range(2):
        ff.run(SCENARIO, SHORT, directory=".", existing="overwrite")
        assert names(tmp_path) == WHOLE
    for options in ([], ["--keep"]):
        code, error = run_command(capsys, "run", SCENARIO, *SET, "--out", ".", *options)
        assert code == 2
        assert "it is the current directory and is not empty" in error
    assert names(tmp_path) == WHOLE


@pytest.mark.parametrize("existing", ["keep", "overwrite"])
def test_a_policy_without_a_directory_is_rejected(
    existing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ff.CosimError, match=f"--{existing} applies to a directory that is given"):
        ff.run("multirate_passive", {"stop_s": 0.01}).save(existing=existing)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []
