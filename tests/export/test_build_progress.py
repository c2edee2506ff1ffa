"""A build of FMUs reports what it compiles, and keeps the whole FMUs if it is interrupted."""

from __future__ import annotations

from pathlib import Path

import pytest
from fmpy.validation import validate_fmu

from freeflyer.cli import main as command
from freeflyer_fmus import Block, export_fmus
from freeflyer_fmus.export.archive import build_all

BLOCK = "from test_build_progress import lag\ndef block(robot):\n    return lag('lag')\n"


def lag(name: str) -> Block:
    block = Block(name, "A first-order lag")
    u = block.input("u", 0.0, "1", "In")
    x = block.state("x", 0.0, "1", "Out")
    block.derivative("x", u - x)
    return block


def test_the_progress_counts_the_libraries_and_names_the_present_one(tmp_path: Path) -> None:
    calls: list[tuple[int, int, str]] = []
    export_fmus(
        tmp_path,
        block=lag("lag"),
        platforms=["x86_64-linux", "aarch64-linux"],
        progress=lambda *call: calls.append(call),
    )
    assert calls == [(0, 2, "lag for x86_64-linux"), (1, 2, "lag for aarch64-linux")]


def test_an_interrupted_build_keeps_whole_fmus(tmp_path: Path) -> None:
    def interrupt(finished: int, total: int, name: str) -> None:
        if finished:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(build_all([lag("first"), lag("second")], tmp_path, progress=interrupt))
    made = sorted(path for path in tmp_path.rglob("*") if path.is_file())
    assert made == [tmp_path / "fmi2" / "first.fmu", tmp_path / "fmi3" / "first.fmu"]
    assert [validate_fmu(str(path)) for path in made] == [[], []]


def test_without_a_terminal_a_build_prints_one_line_for_each_block(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(BLOCK)

    assert command.call(["fmus", "--block", "own.py", "--out", "fmus"]) == 0
    assert capsys.readouterr().out == "lag: fmus/fmi2/lag.fmu, fmus/fmi3/lag.fmu\n"
