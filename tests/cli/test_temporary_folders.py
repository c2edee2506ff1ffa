"""Temporary folders do not remain after their process, and no process removes those of another."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from commands import run_command
from small_disk import mounted

from freeflyer.foundation import temporary_folder
from freeflyer.foundation.errors import CosimError
from freeflyer.foundation.temporary_folder import LOCK, PREFIX, TemporaryFolder

HOLDER = """
import os, sys
from freeflyer.foundation.temporary_folder import TemporaryFolder
folder = TemporaryFolder()
(folder.path / "file").write_text("content")
{more}
print(folder.path.parent, flush=True)
sys.stdin.read()
"""
MANY = """
from freeflyer.foundation import temporary_folder
for _ in range(100):
    temporary_folder._remove_abandoned.cache_clear()  # each folder is that of a new start
    with temporary_folder.TemporaryFolder() as path:
        (path / "file").write_text("content")
        temporary_folder._remove_abandoned.cache_clear()
        temporary_folder.TemporaryFolder().remove()
        assert (path / "file").read_text() == "content"
    assert not path.exists()
"""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The temporary directory of this process and of its children."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def started(code: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def holder(more: str = "") -> tuple[subprocess.Popen[str], Path]:
    """A process with a temporary folder, and this folder."""
    process = started(HOLDER.format(more=more))
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


def killed(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.communicate()


def open_files(number: str) -> list[str]:
    """Names of the open files of a process. A file that is closed meanwhile is left out."""
    names = []
    for path in Path("/proc", number, "fd").iterdir():
        with suppress(FileNotFoundError):
            names.append(os.readlink(path))
    return names


def next_start() -> None:
    temporary_folder._remove_abandoned.cache_clear()
    TemporaryFolder().remove()


def test_the_folder_of_a_killed_process_is_removed_by_the_next_start(place: Path) -> None:
    process, folder = holder()
    next_start()
    assert (folder / "content" / "file").read_text() == "content"  # the process lives
    killed(process)
    assert folder.exists()
    next_start()
    assert not list(place.iterdir())


def test_no_folder_remains_after_an_orderly_end(place: Path) -> None:
    process, folder = holder()
    assert folder.exists()
    process.communicate()
    assert process.returncode == 0
    assert not list(place.iterdir())


@pytest.mark.parametrize("child", ["if os.fork() == 0: os.execlp('sleep', 'sleep', '60')", "if os.fork() == 0: print(end='', flush=True); sys.stdin.close(); __import__('time').sleep(60)"], ids=["exec", "fork"])  # fmt: skip
def test_a_child_does_not_keep_the_folder_of_its_killed_parent(place: Path, child: str) -> None:
    # The folder of the parent is not removed while the parent lives, although the child has ended.
    process, folder = holder(f"pid = os.fork()\nif pid == 0: sys.exit()\nos.waitpid(pid, 0)\n{child}")  # fmt: skip
    assert (folder / "content" / "file").exists()
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    while any(LOCK in name for number in children for name in open_files(number)):
        time.sleep(0.01)  # until the child has started
    process.kill()
    process.wait()
    try:
        assert children
        assert all(Path("/proc", number).exists() for number in children)
        next_start()
        assert not folder.exists()
    finally:
        for number in children:
            os.kill(int(number), signal.SIGKILL)
        process.communicate()


def test_processes_at_once_never_remove_the_folder_of_another(place: Path) -> None:
    processes = [started(MANY) for _ in range(3)]
    for process in processes:
        process.communicate()
    assert [process.returncode for process in processes] == [0, 0, 0]
    assert not list(place.iterdir())


@pytest.mark.slow
def test_nothing_remains_of_processes_that_are_killed_at_any_moment(place: Path) -> None:
    for k in range(60):
        processes = [started(MANY.replace("range(100)", "range(10**9)")) for _ in range(2)]
        while not list(place.glob(f"{PREFIX}*")):
            pass
        time.sleep(k * 1e-4)
        for process in processes:
            killed(process)
        next_start()
        # A process may die while Python's tempfile tries the directory with a file of its own.
        assert not list(place.glob(f"{PREFIX}*"))


def test_threads_at_once_have_folders_of_their_own(place: Path) -> None:
    made: list[TemporaryFolder] = []

    def make() -> None:
        for _ in range(20):
            temporary_folder._remove_abandoned.cache_clear()
            made.append(TemporaryFolder())

    threads = [threading.Thread(target=make) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({one.path for one in made}) == 80
    assert all(one.path.is_dir() for one in made)
    made.clear()  # the folders are removed with their objects
    assert not list(place.iterdir())


def test_other_folders_stay(place: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    target = tmp_path_factory.mktemp("target")
    for folder in (target, place / f"{PREFIX}of-a-user", place / "another"):
        folder.mkdir(exist_ok=True)
        (folder / ("file" if folder.name.startswith(PREFIX) else LOCK)).touch()
    (place / f"{PREFIX}link").symlink_to(target)
    (place / f"{PREFIX}file").touch()
    linked = place / f"{PREFIX}linked-lock"
    linked.mkdir()
    (linked / LOCK).symlink_to(target / LOCK)
    names = {path.name for path in place.iterdir()}
    (place / f"{PREFIX}killed-before-the-lock").mkdir()
    next_start()
    assert {path.name for path in place.iterdir()} == names
    assert (target / LOCK).exists()


@pytest.mark.skipif(os.getuid() != 0, reason="only root can make the folder of another user")
def test_the_folder_of_another_user_stays(place: Path) -> None:
    folder = place / f"{PREFIX}other"
    folder.mkdir()
    (folder / LOCK).touch()
    os.chown(folder, 12345, 12345)
    next_start()
    assert (folder / LOCK).exists()
    os.chown(folder, 0, 0)
    next_start()
    assert not folder.exists()


def test_an_interrupted_removal_is_completed_at_the_end(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = TemporaryFolder()
    with monkeypatch.context() as patch:

        def interrupted(*_: object, **__: object) -> None:
            raise KeyboardInterrupt

        patch.setattr("shutil.rmtree", interrupted)
        with pytest.raises(KeyboardInterrupt):
            folder.remove()
    assert folder.path.exists()
    temporary_folder._remove_all()
    assert not list(place.iterdir())


def test_a_temporary_directory_that_cannot_be_used_is_one_sentence(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ("run", "multirate_passive", "--out", str(tmp_path / "out"))
    monkeypatch.setattr(tempfile, "tempdir", "/proc")
    code, error = run_command(capsys, *arguments)
    assert code == 2
    assert error.startswith("freeflyer: a temporary folder cannot be made: /proc: ")
    assert "set TMPDIR to a directory that can be written" in error

    def none() -> str:
        raise FileNotFoundError(2, "No usable temporary directory found in ['/tmp', '/var/tmp']")

    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "gettempdir", none)
    code, error = run_command(capsys, *arguments)
    assert code == 2
    assert "cannot be made: no temporary directory can be written; set TMPDIR" in error


def test_a_full_temporary_directory_is_one_sentence(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with mounted(tmp_path / "small", "64k") as small:
        monkeypatch.setattr(tempfile, "tempdir", str(small))
        code, error = run_command(
            capsys, "run", "multirate_passive", "--out", str(tmp_path / "out")
        )
        assert code == 2
        assert "No space left on device" in error
        assert not list(small.iterdir())


def test_without_locks_a_folder_is_used_and_removed(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unsupported(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", unsupported)
    folder = TemporaryFolder()
    next_start()
    assert folder.path.is_dir()
    folder.remove()
    assert not list(place.iterdir())


def test_a_killed_run_leaves_nothing_after_the_next_run(
    capsys: pytest.CaptureFixture[str], place: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    out = str(tmp_path_factory.mktemp("out") / "run")
    command = [sys.executable, "-m", "freeflyer.cli.main", "run", "multirate_passive"]
    with subprocess.Popen([*command, "--set", "stop_s=3000", "--out", out]) as process:
        end = time.monotonic() + 60.0
        while len(list(place.glob("freeflyer-*"))) < 4 and time.monotonic() < end:
            time.sleep(0.01)
        process.kill()
    assert list(place.glob("freeflyer-*"))
    temporary_folder._remove_abandoned.cache_clear()
    code, _ = run_command(
        capsys, "run", "multirate_passive", "--set", "stop_s=0.01", "--out", f"{out}-next"
    )
    assert code == 0
    assert not list(place.glob("freeflyer-*"))


def test_the_error_of_an_fmu_build_is_that_of_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    from freeflyer_fmus import FmuSourceError
    from freeflyer_fmus.export.archive import _scratch

    monkeypatch.setattr(tempfile, "tempdir", "/proc")
    with (
        pytest.raises(FmuSourceError, match="a temporary folder cannot be made: /proc"),
        _scratch(),
    ):
        pass
    with pytest.raises(CosimError):
        TemporaryFolder()
