"""The options `--check` and `--accelerated` of `freeflyer hil`, with both ends in one process."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pandas
import pytest

from freeflyer.cli.main import call


def test_a_check_shows_the_measurements_and_moves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(["hil", "facility", "--check", "--accelerated"]) == 0
    output = capsys.readouterr().out
    assert "arm_drive measures" in output
    assert "0  0.1  -1.6  0  -1.4  0" in output  # the posture of the scenario
    assert "could be activated. Nothing was activated." in output
    assert "active" not in output.replace("activated", "")


def test_a_check_reports_why_a_device_could_not_be_activated(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert (
        call(
            [
                "hil",
                "facility",
                "--check",
                "--accelerated",
                "--set",
                "base_robot.true_position=[0.1, 0, 0.08]",
            ]
        )
        == 2
    )
    both = capsys.readouterr()
    # The check takes 0.1 s, in which the base moves by less than a thousandth of its limits.
    assert re.search(
        r"the distance is 0\.0600 m and 0\.00\d deg, at most 0\.005 m and 0\.573 deg are allowed",
        both.err,
    ), both.err
    assert "Traceback" not in both.err


def test_accelerated_runs_the_experiment_with_the_faults_of_the_scenario(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cut.toml"
    path.write_text(
        'extends = "facility"\nstop_s = 1.0\n[[facility.faults]]\ndevice = "arm_drive"\nkind = "cut"\nbegin_s = 0.5\n'
    )
    assert call(["hil", str(path), "--accelerated", "--out", str(tmp_path / "out")]) == 3
    both = capsys.readouterr()
    assert "fault: cut of arm_drive, both: 0.5 s after activation" in both.out
    assert "active -> safe_stop: no command for 4 cycles" in both.out
    assert "20 cycles in a row were lost" in both.err
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["simulated_s"] == pytest.approx(0.52, abs=0.005)
    record = pandas.read_parquet(tmp_path / "out" / "record.parquet")
    assert record["time"].iloc[-1] == pytest.approx(0.51, abs=0.011)


@pytest.mark.parametrize(
    ("device", "sentence"),
    [("arm_drive", "no description frame within"), ("base_robot", "no valid sample on topic")],
)
def test_a_link_that_is_cut_from_the_start_is_reported_and_nothing_moves(
    device: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cut.toml"
    path.write_text(
        f'extends = "facility"\n[[facility.faults]]\ndevice = "{device}"\nkind = "cut"\n'
    )
    assert call(["hil", str(path), "--accelerated", "--out", str(tmp_path / "out")]) == 2
    both = capsys.readouterr()
    assert sentence in both.err
    assert ".py, line" not in both.err
    assert "active ->" not in both.out


def test_simulated_and_accelerated_exclude_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        call(["hil", "facility", "--simulated", "--accelerated"])
    assert ended.value.code == 2
    assert "not allowed with" in capsys.readouterr().err
