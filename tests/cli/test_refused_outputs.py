"""A refused command makes no directory. A place without space or permission is one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from commands import run_command
from small_disk import fill, mounted

from freeflyer.foundation.errors import OutputError
from freeflyer.foundation.output_file import check_writable, write_text, write_whole
from freeflyer_fmus import BuildError, export_fmus

SWEEP = 'scenario = "multirate_passive"\n[grid]\n"base_controller.period" = [0.1]\n'
BLOCK = "def block(robot):\n    return 1\n"
# Each command with its output: a directory, or a file in a directory.
OUTPUTS = {
    "fmus": ("fmus", "--block", "block.py", "--out", "{out}"),
    "predict": ("predict", "multirate_unstable", "--out", "{out}"),
    "export": ("export", "multirate_passive", "--out", "{out}/system.ssp"),
    "facility": ("facility", "facility", "--out", "{out}"),
    "certificates": ("certificates", "{out}"),
    "recover": ("recover", "part.mcap", "--out", "{out}/whole.mcap"),
    "sweep": ("sweep", "sweep.toml", "--out", "{out}"),
}
MISTAKES = {
    "fmus": (),  # the block
    "predict": ("--set", "free_flyer.base_mass=-1"),
    "export": ("--set", "free_flyer.no_mass=1"),
    "facility": ("--set", "facility.cycle_s=-1"),
    "certificates": ("--days", "0"),
    "recover": (),  # the recording
    "sweep": ("--set", "free_flyer.no_mass=1"),
}


@pytest.fixture(autouse=True)
def _directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("block.py").write_text(BLOCK)
    Path("part.mcap").write_bytes(b"no recording")
    Path("sweep.toml").write_text(SWEEP)


@pytest.fixture
def full_disk(tmp_path: Path) -> Iterator[Path]:
    with mounted(tmp_path / "disk", "64k") as place:
        fill(place)
        yield place


def arguments(name: str, out: Path | str) -> list[str]:
    return [text.format(out=out) for text in OUTPUTS[name]]


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_mistake_leaves_no_output_directory(
    capsys: pytest.CaptureFixture[str], name: str
) -> None:
    before = set(Path().iterdir())
    code, error = run_command(capsys, *arguments(name, "new/out"), *MISTAKES[name])
    assert code == 2, error
    assert set(Path().iterdir()) - {Path("__pycache__")} == before  # Python's, of the block file


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_read_only_place_is_bad_input(capsys: pytest.CaptureFixture[str], name: str) -> None:
    code, error = run_command(capsys, *arguments(name, "/proc/new/out"))
    assert code == 2
    assert error.startswith("freeflyer: output directory /proc/new/out cannot be written: ")


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_full_disk_is_reported_at_the_start(
    capsys: pytest.CaptureFixture[str], full_disk: Path, name: str
) -> None:
    code, error = run_command(capsys, *arguments(name, full_disk / "out"))
    assert code == 2
    assert (
        error
        == f"freeflyer: output directory {full_disk / 'out'} cannot be written: No space left on device\n"
    )
    assert [path.name for path in full_disk.iterdir()] == ["filling"]


@pytest.mark.parametrize(
    ("name", "reason"),
    [("block.py/out", "Not a directory"), ("x" * 300, "File name too long"), ("link", "No such")],
)
def test_a_name_that_no_directory_can_have_is_refused(name: str, reason: str) -> None:
    Path("link").symlink_to("nowhere")
    with pytest.raises(OutputError, match=reason) as caught:
        check_writable(Path(name))
    assert caught.value.exit_code == 2


def test_a_python_export_into_a_read_only_place_raises_the_error_of_the_package() -> None:
    with pytest.raises(BuildError, match="output directory /proc/new cannot be written"):
        export_fmus("/proc/new")


def test_a_file_that_is_not_written_leaves_no_directories() -> None:
    Path("old").mkdir()

    def fail(path: Path) -> None:
        path.write_text("a part")
        raise ValueError

    for name in ("new/a/file", "old/file"):
        with pytest.raises(ValueError):  # noqa: PT011
            write_whole(Path(name), fail)
    assert not Path("new").exists()
    assert not list(Path("old").iterdir())
    write_text(Path("new/file"), "whole")
    with pytest.raises(ValueError):  # noqa: PT011
        write_whole(Path("new/file"), fail)
    assert Path("new/file").read_text() == "whole"
