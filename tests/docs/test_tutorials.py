"""Run the examples of docs/own_robots_and_blocks.md and check the results that the page states."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import pandas
import pytest
from commands import run_command
from robots import ur5_path

from freeflyer.cli import main as command

TEXT = (Path(__file__).parents[2] / "docs" / "own_robots_and_blocks.md").read_text(encoding="utf-8")


def example(language: str, containing: str) -> str:
    """Return the first code block of the page that contains a text."""
    return next(
        code
        for code in re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)
        if containing in code
    )


def run_summary(scenario: str, *arguments: str, code: int = 0) -> dict[str, Any]:
    """Run a scenario file, check the exit code and return summary.json."""
    assert command.call(["run", scenario, *arguments]) == code
    file = Path("freeflyer_out") / Path(scenario).stem / "summary.json"
    summary: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return summary


@pytest.mark.slow
def test_a_ur5_tracks_with_the_stated_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(ur5_path(), "ur5_robot.urdf")
    arguments = shlex.split(example("sh", "ur5_robot.urdf"))
    assert arguments[0] == "freeflyer"
    assert command.call(arguments[1:]) == 0, capsys.readouterr().err
    Path("ur5.toml").write_text(example("toml", "[robot]"))
    early = run_summary("./ur5.toml", "--set", "stop_s=20")
    assert early["end_effector_position_error_m"]["max"] == pytest.approx(7e-6, rel=0.1)
    assert early["base_position_error_m"]["max"] < 3e-3
    error = run_summary("./ur5.toml")["end_effector_position_error_m"]["max"]
    assert error == pytest.approx(440e-6, rel=0.1)
    tracking = shlex.split(example("sh", "observer=tracking"))[3:]
    error = run_summary("./ur5.toml", *tracking)["end_effector_position_error_m"]["max"]
    assert error == pytest.approx(7.5e-6, rel=0.1)


def test_a_thruster_lag_makes_the_loop_diverge_at_the_stated_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("thruster_lag.py").write_text(example("python", "thruster_lag"))
    assert command.call(["fmus", "--block", "thruster_lag.py", "--out", "fmus"]) == 0
    Path("lag.toml").write_text(example("toml", "thruster_lag"))
    diverged = run_summary("./lag.toml", code=3)
    assert diverged["diverged_at_s"] == pytest.approx(19.4, abs=0.1)
    completed = run_summary("./lag.toml", "--set", "thruster_lag.time_constant=0.02")
    assert completed["end_effector_position_error_m"]["max"] == pytest.approx(10e-6, rel=0.1)
    in_process = example("toml", "thruster_lag").replace(
        'fmu = "fmus/fmi2/thruster_lag.fmu"', 'kind = "twin"\nblock = "thruster_lag.py"'
    )
    Path("in_process.toml").write_text(in_process)
    run_summary("./in_process.toml", "--set", "stop_s=3")


def test_a_python_component_adds_a_torque_for_ten_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("kick.py").write_text(example("python", "class Kick"))
    Path("kick.toml").write_text(example("toml", "kick.command"))
    summary = run_summary("./kick.toml", "--set", "stop_s=11")
    assert summary["end_effector_position_error_m"]["max"] == pytest.approx(0.9e-3, rel=0.1)
    frame = pandas.read_parquet("freeflyer_out/kick/record.parquet")
    torque = frame["kick.torque[2]"] - frame["manipulator_controller.joint_torque[2]"]
    assert torque.max() == pytest.approx(0.5)
    assert (torque > 0.1).sum() == 10


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("from fmu_src.block import WRENCH, Block", "freeflyer_fmus"),
        ("from cosim.component import PythonComponent", "freeflyer"),
        ("import adapters.pose", "freeflyer_adapters"),
    ],
)
def test_an_import_name_of_0_1_0_is_rejected_with_the_new_name(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    old: str,
    new: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    block = example("python", "thruster_lag").replace(
        "from freeflyer_fmus import WRENCH, Block", old
    )
    Path("thruster_lag.py").write_text(block)
    kick = example("python", "class Kick").replace(
        "from freeflyer import Port, PythonComponent", old
    )
    Path("kick.py").write_text(kick)
    Path("kick.toml").write_text(
        'stop_s = 1\n[components.kick]\nkind = "python"\nobject = "kick.py:Kick"\nstep_s = 0.01\n'
    )
    inside = example("python", "class Kick").replace(
        "        kick =", f"        {old}\n        kick ="
    )
    Path("inside.py").write_text(inside)
    Path("inside.toml").write_text(Path("kick.toml").read_text().replace("kick.py", "inside.py"))
    assert all(old in text for text in (block, kick, inside))
    for arguments in (
        ["fmus", "--block", "thruster_lag.py"],
        ["run", "kick.toml"],
        ["run", "inside.toml"],
    ):
        code, error = run_command(capsys, *arguments)
        assert code == 2
        assert (
            f"since 0.2.0 {old.split()[1].split('.')[0]} is {new}: see the table in CHANGELOG.md"
            in error
        )
