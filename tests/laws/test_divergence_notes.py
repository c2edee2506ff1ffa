"""Notes after a diverged run: sampled dampers above their limit."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import freeflyer as ff
from freeflyer.analysis import divergence_notes
from freeflyer.cli import main as command

NAME = "multirate_unstable"
ARM, BASE = "manipulator_controller", "base_controller"
UNSTABLE = {f"{ARM}.damping": [80.0, 80.0, 80.0, 30.0, 30.0, 30.0]}
TWINS = "".join(
    f'[components.{name}]\nkind = "twin"\n'
    for name in ("free_flyer", ARM, BASE, "reference_trajectory")
)
PYTHON = """
from freeflyer_fmus.in_process_block import InProcessBlock
def plant(name):
    return InProcessBlock("free_flyer", name)
"""


def notes(scenario: str | Path, changes: dict[str, Any]) -> list[str]:
    run = ff.run(scenario, changes)
    return divergence_notes.notes(run.scenario, run.record)


def ratio(note: str) -> float:
    found = re.search(r"M~ = (\S+) in", note)
    assert found is not None
    return float(found[1])


@pytest.mark.parametrize(
    "changes", [{}, {"exchange": "parallel"}, {f"{ARM}.damping": [9000.0] * 3 + [3.0] * 3}], ids=str
)
def test_the_note_has_the_ratio_of_the_prediction(changes: dict[str, Any]) -> None:
    """One is from differences of simulated steps, the other from derivatives of the FMUs."""
    changes = {**UNSTABLE, **changes}
    (note,) = notes(NAME, {**changes, "stop_s": 1.0})
    damper = ff.predict(NAME, changes, longest=0.001).coordinates.fast_damper
    assert ratio(note) == pytest.approx(damper.ratio, rel=5e-3)
    assert damper.motion("end-effector") in note
    assert f"{ARM}.discretisation = matched" in note


def test_the_note_on_the_base_has_the_ratio_of_the_prediction() -> None:
    (note,) = notes("overdamped_base", {})
    found = ff.predict("overdamped_base")
    assert found.limit is not None
    at_boundary = found.limit.damper.max() / (found.largest_stable_s + found.tick_s)
    assert ratio(note) == pytest.approx(at_boundary * found.period_s, rel=0.02)
    assert "in base rotation about (0.00, 1.00, 0.00)" in note


@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_a_note_is_there_only_above_the_limit(factor: float) -> None:
    quiet = ff.predict(NAME, longest=0.001).coordinates.fast_damper.ratio
    damping = (np.array([80.0] * 3 + [3.0] * 3) * factor / quiet).tolist()
    found = notes(NAME, {f"{ARM}.damping": damping, "stop_s": 0.01})
    assert [ratio(note) for note in found] == ([1.02] if factor > 1.0 else [])


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        (NAME, {}),  # diverges after 46 s by the sampled spring of the base
        (NAME, {**UNSTABLE, f"{ARM}.discretisation": "matched", "stop_s": 0.01}),
        (NAME, {**UNSTABLE, "stop_s": 0.01, "record.signals": ["free_flyer.joint_velocity"]}),
        ("disturbed", {**UNSTABLE, f"{ARM}.discretisation": "emulated", "stop_s": 0.01}),
        ("facility", {**UNSTABLE, "stop_s": 0.01}),
    ],
    ids=["another cause", "matched law", "inputs not recorded", "a delay between", "drives"],
)
def test_there_is_no_note_without_a_known_cause(name: str, changes: dict[str, Any]) -> None:
    assert notes(name, changes) == []


def test_blocks_in_the_process_have_a_note_and_components_of_users_have_none(
    tmp_path: Path,
) -> None:
    loop = f'extends = "{NAME}"\nstop_s = 0.01\n{TWINS}'
    file = tmp_path / "loop.toml"
    file.write_text(loop)
    (note,) = notes(file, UNSTABLE)
    assert ratio(note) == pytest.approx(3.67, rel=5e-3)
    (tmp_path / "plant.py").write_text(PYTHON)
    file.write_text(loop.replace('"twin"', '"python"\nobject = "plant.py:plant"', 1))
    assert notes(file, UNSTABLE) == []


def test_the_command_prints_the_note_of_a_diverged_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change = f"{ARM}.damping=[80, 80, 80, 30, 30, 30]"
    assert command.call(["run", NAME, "--set", change, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "Diverged at" in printed
    assert "Note: The sampled damper of manipulator_controller was unstable" in printed
    assert "K_D T_m / 2 M~ = 3.67" in printed
