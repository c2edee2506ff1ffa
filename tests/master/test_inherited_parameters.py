"""A file can replace a component of the scenario that it extends, without its parameters."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import run_command

HEAD = """
extends = "paper_passive"
stop_s = 0.1
[components.reference_trajectory]
fmu = "waypoint_trajectory"
"""


def test_without_inherited_parameters_another_fmu_can_take_the_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "mine.toml", str(tmp_path / "out")
    path.write_text(HEAD)
    code, error = run_command(capsys, "run", str(path), "--out", out)
    assert code == 2
    assert "has no parameter 'shape'" in error
    assert "inherited_parameters = false" in error
    more = "inherited_parameters = false\n[components.reference_trajectory.parameters]\n"
    path.write_text(f"{HEAD}{more}waypoint_t = {{ first = [0, 1] }}\n")
    assert run_command(capsys, "run", str(path), "--out", out)[0] == 0


def test_the_key_must_be_a_boolean(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(HEAD + 'inherited_parameters = "no"')
    code, error = run_command(capsys, "run", str(path), "--out", str(tmp_path / "out"))
    assert code == 2
    assert "inherited_parameters" in error
