"""The documents' examples, run as they stand."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from commands import run_command
from robots import ur5_path

from freeflyer.cli import main as command

TEXT = (Path(__file__).parents[2] / "docs" / "own_robots_and_blocks.md").read_text(encoding="utf-8")


def example(language: str, containing: str) -> str:
    return next(
        code
        for code in re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)
        if containing in code
    )


@pytest.mark.slow
def test_the_users_robot_in_the_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(ur5_path(), "ur5_robot.urdf")
    words = shlex.split(example("sh", "ur5_robot.urdf"))
    assert words[0] == "freeflyer"
    assert command.call(words[1:]) == 0, capsys.readouterr().err
    Path("ur5.toml").write_text(example("toml", "[robot]"))
    assert command.call([*shlex.split(example("sh", "ur5.toml"))[1:], "--set", "stop_s=12"]) == 0, (
        capsys.readouterr().err
    )
    summary = json.loads(Path("freeflyer_out/ur5/summary.json").read_text())
    assert summary["end_effector_position_error_m"]["max"] < 2e-5
    assert summary["base_position_error_m"]["max"] < 3e-3


def test_the_users_block_in_the_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("thruster_lag.py").write_text(example("python", "thruster_lag"))
    assert command.call(["fmus", "--block", "thruster_lag.py", "--out", "fmus"]) == 0
    Path("lag.toml").write_text(example("toml", "thruster_lag"))
    assert command.call(["run", "lag.toml", "--set", "stop_s=3"]) == 0, capsys.readouterr().err
    twin = example("toml", "thruster_lag").replace(
        'fmu = "fmus/fmi2/thruster_lag.fmu"', 'kind = "twin"\nblock = "thruster_lag.py"'
    )
    Path("twin.toml").write_text(twin)
    assert command.call(["run", "twin.toml", "--set", "stop_s=3"]) == 0, capsys.readouterr().err


def test_the_users_python_component_in_the_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("kick.py").write_text(example("python", "class Kick"))
    Path("kick.toml").write_text(
        'extends = "multirate_passive"\n'
        'connections = ["manipulator_controller.joint_torque -> kick.command", "kick.torque -> free_flyer.joint_torque"]\n'
        '[components.kick]\nkind = "python"\nobject = "kick.py:Kick"\nstep_s = 0.001\n'
    )
    assert command.call(["run", "kick.toml", "--set", "stop_s=11"]) == 0, capsys.readouterr().err
    import pandas

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
def test_an_import_name_of_0_1_0_is_refused_with_the_new_one(
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
    for words in (
        ["fmus", "--block", "thruster_lag.py"],
        ["run", "kick.toml"],
        ["run", "inside.toml"],
    ):
        code, error = run_command(capsys, *words)
        assert code == 2
        assert (
            f"since 0.2.0 {old.split()[1].split('.')[0]} is {new}: see the table in CHANGELOG.md"
            in error
        )
