"""Sweeps on a local cluster have the same results as `freeflyer run`."""

from __future__ import annotations

import json
from pathlib import Path

import pandas
import pytest

from freeflyer.analysis.sweep import stability
from freeflyer.cli import main as command

SWEEP = """
title = "Two periods, two factors"
scenario = "multirate_unstable"
set = ["stop_s=30.5"]
[cases.without_pc]
[cases.with_pc]
manipulator_controller.manipulator_passivity_control = true
manipulator_controller.base_passivity_control = true
[grid]
"base_controller.period" = [0.1, 0.5]
"base_controller.damping[4:6]" = { values = [1.0, 100.0], relative = true }
"free_flyer.base_mass" = [150, -1]
"""


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("swept")
    (directory / "some.toml").write_text(SWEEP)
    assert (
        command.call(
            [
                "sweep",
                str(directory / "some.toml"),
                "--workers",
                "2",
                "--out",
                str(directory / "out"),
            ]
        )
        == 0
    )
    return directory / "out"


def test_every_design_is_run_in_every_case(swept: Path) -> None:
    frame = pandas.read_parquet(swept / "results.parquet")
    assert list(frame["run"]) == list(range(16))
    axes = [
        "base_controller.period",
        "base_controller.damping[4:6]",
        "free_flyer.base_mass",
        "case",
    ]
    assert not frame.duplicated(axes).any()
    assert frame.attrs["units"]["base_controller.period"] == "s"
    assert frame.attrs["units"]["base_position_error_m_max"] == "m"


def test_a_row_equals_the_result_of_a_single_run(swept: Path, tmp_path: Path) -> None:
    frame = pandas.read_parquet(swept / "results.parquet")
    picked = frame["base_controller.period"].eq(0.5) & frame["base_controller.damping[4:6]"].eq(
        100.0
    )
    row = frame[picked & frame["free_flyer.base_mass"].eq(150) & frame["case"].eq("with_pc")].iloc[
        0
    ]
    settings = (
        "stop_s=30.5",
        "base_controller.period=0.5",
        "base_controller.damping=[10, 10, 10, 200, 200, 200]",
    )
    command.call(
        ["run", "multirate_unstable", "--out", str(tmp_path)]
        + [f"--set={text}" for text in settings]
        + [
            f"--set=manipulator_controller.{arm}_passivity_control=true"
            for arm in ("manipulator", "base")
        ]
    )
    summary = json.loads((tmp_path / "summary.json").read_text())
    for name in ("diverged", "failed", "simulated_s"):
        assert row[name] == summary[name]
    for name in (name for name in summary if "_error_" in name):
        assert row[f"{name}_max"] == summary[name]["max"]
        assert row[f"{name}_last_10_s"] == summary[name]["last_10_s"]
    for name, energy in summary["observed_energy_j"].items():
        assert row[f"{name}_observed_energy_min_j"] == energy["min"]


def test_a_rejected_value_is_a_failed_row_with_its_cause_and_a_diverged_run_is_a_result(
    swept: Path,
) -> None:
    frame = pandas.read_parquet(swept / "results.parquet")
    refused = frame[frame["free_flyer.base_mass"].eq(-1)]
    assert refused["failed"].all()
    assert refused["cause"].str.contains("more than 0 is expected").all()
    assert not refused["stable"].any()
    rest = frame[frame["free_flyer.base_mass"].eq(150)]
    assert not rest["failed"].any()
    # K_D T_b > 2 M~: the second mechanism of instability. A passivity controller with a bounded
    # damper cannot stabilise it.
    heavy = rest[
        rest["base_controller.period"].eq(0.5) & rest["base_controller.damping[4:6]"].eq(100.0)
    ]
    assert heavy["diverged"].all()
    assert heavy["diverged_at_s"].notna().all()


def test_the_verdict_follows_from_the_row(swept: Path) -> None:
    frame = pandas.read_parquet(swept / "results.parquet")
    for _, row in frame.iterrows():
        bounded = not row["diverged"] and not row["failed"]
        for name in (
            column.removesuffix("_max") for column in frame.columns if column.endswith("_max")
        ):
            allowed = max(
                stability.GROWTH * row[f"{name}_earlier"], stability.FLOORS[name.rpartition("_")[2]]
            )
            bounded = bounded and row[f"{name}_last_10_s"] <= allowed
        assert row["stable"] == bounded


def test_a_finished_sweep_is_not_computed_again(
    swept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.stat().st_mtime_ns for path in (swept / "parts").iterdir()}
    assert command.call(["sweep", str(swept.parent / "some.toml"), "--out", str(swept)]) == 0
    assert "16 of 16 runs are in" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in (swept / "parts").iterdir()} == before
