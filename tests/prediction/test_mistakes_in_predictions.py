"""Errors in the arguments of `freeflyer predict`: one-line message, exit code 2."""

from __future__ import annotations

from pathlib import Path
from zipfile import ZipFile

import pytest
from commands import run_command

MISTAKES = {
    "misspelt scenario": (["multirate_unstabel"], "did you mean 'multirate_unstable'?"),
    "SSP file": (["loop.ssp"], "a scenario is expected here"),
    "misspelt parameter": (
        ["multirate_unstable", "--set", "base_controller.perod=1"],
        "did you mean 'period'?",
    ),
    "override without a value": (
        ["multirate_unstable", "--set", "base_controller"],
        "COMPONENT.PARAMETER=VALUE is expected",
    ),
    "zero time": (
        ["multirate_unstable", "--longest", "0"],
        "a time of 0.001 s (the fast controllers' step) or more is expected",
    ),
    "not a number": (["multirate_unstable", "--longest", "nan"], "--longest nan"),
    "text instead of a number": (
        ["multirate_unstable", "--longest", "long"],
        "argument --longest: 'long' is not a number",
    ),
    "too many periods": (["multirate_unstable", "--longest", "1e9"], "at most 100 s is expected"),
    "misspelt controller": (
        ["multirate_unstable", "--period", "base_controler"],
        "did you mean 'base_controller'?",
    ),
    "component that is not a controller": (
        ["multirate_unstable", "--period", "free_flyer"],
        "is not a controller whose step_s is a parameter",
    ),
    "read-only directory": (["multirate_unstable", "--out", "/proc/nowhere"], "cannot be written"),
    "empty directory name": (["multirate_unstable", "--out", ""], "a directory is expected"),
    "moving start": (
        ["multirate_unstable", "--set", "free_flyer.base_velocity=0.1"],
        "the start is not a set point",
    ),
    "base away from its set point": (
        ["multirate_unstable", "--set", "base_controller.position_setpoint=[0.1, 0, 0]"],
        "the start is not a set point",
    ),
    "singular posture": (
        ["multirate_unstable", "--set", "free_flyer.joint_position=0"],
        "singular value of J_m",
    ),
    "actuators with a dead zone": (
        ["disturbed", "--set", "base_actuators.on_off=true"],
        "without a dead zone",
    ),
    "delay with another period": (
        [
            "disturbed",
            *("--set", "base_command_delay.command_period=0.02"),
            *("--set", "base_command_delay.delay=0.02"),
        ],
        "component base_command_delay has memory",
    ),
    "delay of the arm by several samples": (
        [
            "disturbed",
            *("--set", "arm_command_delay.command_period=0.007"),
            *("--set", "arm_command_delay.delay=0.007"),
        ],
        "component arm_command_delay has memory",
    ),
    "delay with a period that is a number": (
        [
            "disturbed",
            *("--set", "base_command_delay.command_period=0.3"),
            *("--set", "base_command_delay.delay=0.3"),
        ],
        "does not follow the period of the slow controllers",
    ),
    "period between samples": (
        ["multirate_unstable", "--set", "base_controller.period=0.0015"],
        "0.001 s or 0.002 s would fit",
    ),
    "plant that is too slow": (
        ["multirate_unstable", "--set", "free_flyer.step_s=0.002"],
        "0.001 s is expected",
    ),
    "controller that misses samples": (
        ["multirate_unstable", "--set", "manipulator_controller.step_s=0.002"],
        "passes over a sample",
    ),
    "motion that is too short": (
        ["multirate_unstable", "--along-trajectory", "--set", "stop_s=0.5"],
        "along a trajectory 2.4 s or more are expected",
    ),
    "infeasible motion": (
        [
            "multirate_unstable",
            "--along-trajectory",
            "--set",
            "reference_trajectory.translation_amplitude=2",
        ],
        "there is no trajectory for the prediction",
    ),
    "controllers with a nonlinear memory": (
        ["facility"],
        "the prediction needs controllers without memory",
    ),
    "longest period that the controllers reject": (
        ["robust", "--longest", "0.02"],
        "--longest 0.02: 0.03 s or more is expected",
    ),
    "delay that fits only one period": (
        ["disturbed", "--set", "base_command_delay.delay=0.3"],
        "with the period 0.301 s of base_controller: component base_command_delay",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_an_error_has_a_one_line_message(mistake: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments, expected = MISTAKES[mistake]
    try:
        code, error = run_command(capsys, "predict", *arguments)
    except SystemExit as end:  # raised by argparse
        code, error = int(end.code or 0), capsys.readouterr().err
    assert code == 2
    assert expected in error
    assert len(error.strip().splitlines()) == 1


CHANGES = {
    "python": (
        'kind = "python"\nobject = "plant.py:Plant"',
        "is of kind 'python'; the prediction needs FMUs",
    ),
    "twin": ('kind = "twin"\nblock = "free_flyer"', "is of kind 'twin'; the prediction needs FMUs"),
}


@pytest.mark.parametrize("kind", CHANGES)
def test_a_plant_that_is_not_an_fmu_is_rejected(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, expected = CHANGES[kind]
    path = tmp_path / "other.toml"
    path.write_text(f'extends = "multirate_unstable"\n[components.free_flyer]\n{table}\n')
    code, error = run_command(capsys, "predict", str(path))
    assert code == 2
    assert expected in error


def test_an_fmu_without_directional_derivatives_is_rejected(
    fmus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "no_derivatives.fmu"
    with ZipFile(fmus / "fmi2" / "base_controller.fmu") as source, ZipFile(other, "w") as target:
        for name in source.namelist():
            target.writestr(
                name, source.read(name).replace(b' providesDirectionalDerivative="true"', b"")
            )
    path = tmp_path / "no_derivatives.toml"
    path.write_text(
        'extends = "multirate_unstable"\n[components.base_controller]\nfmu = "no_derivatives.fmu"\n'
    )
    code, error = run_command(capsys, "predict", str(path))
    assert code == 2
    assert "provides no directional derivatives" in error


def test_two_plants_are_rejected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "two.toml"
    path.write_text(
        'extends = "multirate_unstable"\n'
        'connections = ["base_controller.base_wrench -> second.base_wrench"]\n'
        '[components.second]\nfmu = "free_flyer"\nstep_s = 0.001\n'
    )
    code, error = run_command(capsys, "predict", str(path))
    assert code == 2
    assert "2 connected components have continuous states (free_flyer, second)" in error


def test_results_are_written_without_temporary_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _ = run_command(
        capsys, "predict", "multirate_unstable", "--longest", "0.12", "--out", str(tmp_path / "out")
    )
    assert code == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "prediction.json",
        "prediction.png",
    ]
