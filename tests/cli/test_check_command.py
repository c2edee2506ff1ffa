"""`freeflyer check` finds the mistakes that `run` and `sweep` find before the first step."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from commands import run_command

from freeflyer.cli import main as command
from freeflyer.master.master import Master

OTHER = "scenario = 'multirate_passive'\n"


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert command.call(["check", *arguments]) == 0
    return " ".join(capsys.readouterr().out.split())


def file(folder: Path, text: str) -> str:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_a_scenario_is_summarised_without_a_step(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("freeflyer.master.native.run", lambda *_: pytest.fail("a step"))
    monkeypatch.setattr(Master, "run", lambda *_: pytest.fail("a step"))
    shown = printed(capsys, "multirate_passive", "--set", "base_controller.period=0.2")
    assert "100 s, sequential exchange, 25 connections" in shown
    assert "free_flyer │ fmu │ 0.001 s" in shown
    assert shown.endswith("No mistakes found")


def test_devices_are_part_of_the_summary(capsys: pytest.CaptureFixture[str]) -> None:
    shown = printed(capsys, "facility")
    assert "Device for freeflyer hil: arm_drive, can_arm" in shown


def test_a_sweep_is_summarised(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    shown = printed(capsys, "stability_map")
    assert "500 designs, 2 cases, 1000 runs of multirate_unstable" in shown
    assert "Varied: base_controller.damping" in shown
    text = f"{OTHER}[grid]\n'base_controller.period' = [0.1, 0.2]\n"
    assert "2 runs of multirate_passive" in printed(capsys, file(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stop = 1", "unknown key 'stop' in the scenario; did you mean 'stop_s'?"),
        ("[components.free_flyer]\nfmuu = 'x'", "unknown key 'fmuu'; did you mean 'fmu'?"),
        ("[components.free_flyer.parameters]\nbase_mas = 1", "no parameter 'base_mas'"),
        ("[components.free_flyer.parameters]\nbase_mass = -3", "more than 0 is expected"),
        ("connections = ['free_flyer.no -> base_controller.base_position']", "'no'"),
        ("[errors]\nbase_position = ['free_flyer.no', 'free_flyer.no']", "no variable 'no'"),
        ("stop_s = 0.0005", "is not a multiple"),
    ],
)
def test_a_mistake_in_a_scenario_is_one_sentence(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, message: str
) -> None:
    name = file(tmp_path, f'extends = "multirate_passive"\n{text}\n')
    code, error = run_command(capsys, "check", name)
    assert (code, message in error) == (2, True), error
    assert run_command(capsys, "run", name, "--out", str(tmp_path / "out")) == (code, error)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[devices.arm_drive]\nchanel = 'x'", "device arm_drive: unknown key 'chanel'"),
        ("[devices.arm_drive]\nkind = 'can_arn'", "did you mean 'can_arm'"),
        ("[devices.base_robot]\ndomain = 233", "domain is 233; a ROS domain from 0 to 232"),
        ("[facility]\nsed = 1", "[facility] sed is not known; did you mean 'seed'?"),
        ("[[facility.faults]]\nkind = 'los'\ndevice = 'arm_drive'", "did you mean 'loss'?"),
    ],
)
def test_a_mistake_in_the_devices_of_a_scenario_is_one_sentence(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, message: str
) -> None:
    code, error = run_command(capsys, "check", file(tmp_path, f'extends = "facility"\n{text}\n'))
    assert (code, message in error) == (2, True), error


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[grid]\n'base_controller.perod' = [1]", "no parameter 'perod'; did you mean 'period'"),
        ("[gird]\nstop_s = [1]\n[map]", "unknown key 'gird' in the sweep"),
        ("[grid]\n'stop_s' = [1, 2]\n[map]\nx = 'stop_s'\ny = { a = 1 }", "[map] y is { a = 1 }"),
    ],
)
def test_a_mistake_in_a_sweep_is_one_sentence(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, message: str
) -> None:
    name = file(tmp_path, f"{OTHER}{text}\n")
    code, error = run_command(capsys, "check", name)
    assert (code, message in error) == (2, True), error
    assert run_command(capsys, "sweep", name, "--out", str(tmp_path / "out")) == (code, error)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "either a scenario or sweep, or --schema is expected"),
        (("facility", "--schema", "sweep"), "either a scenario or sweep, or --schema is expected"),
        (("multirate_pasive",), "there is no scenario 'multirate_pasive'"),
        (("none.toml",), "scenario file none.toml does not exist"),
        (("a\0b.toml",), "does not exist"),
    ],
)
def test_a_mistake_in_the_arguments_is_one_sentence(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    code, error = run_command(capsys, "check", *arguments)
    assert (code, message in error) == (2, True), error


@pytest.mark.parametrize("name", ["scenario", "sweep"])
def test_the_schema_is_printed_as_json(capsys: pytest.CaptureFixture[str], name: str) -> None:
    assert command.call(["check", "--schema", name]) == 0
    assert json.loads(capsys.readouterr().out)["type"] == "object"
