"""Sweeps with one change at a time or with named designs, and evaluations of the user."""

from __future__ import annotations

from pathlib import Path

import pandas
import pytest
from commands import run_command

from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.analysis.sweep.designs import NamedDesigns
from freeflyer.cli import main as command

EVALUATION = """
class Evaluation:
    signals = ["free_flyer.kinetic_energy"]
    columns = {"largest_energy": "J"}

    def measure(self, result):
        return {"largest_energy": float(result.outcome.record["free_flyer.kinetic_energy"].max())}

    def report(self, rows, axes, folder):
        (folder / "mine.txt").write_text(f"{len(rows)} {axes}")
        return f"largest of all: {max(row['largest_energy'] for row in rows):.3g} J"


mine = Evaluation()
"""
SWEEP = """
scenario = "multirate_passive"
set = ["stop_s=1"]
evaluation = "evaluation.py:mine"

[cases.slow]
[cases.fast]
base_controller.period = 0.001

[vary]
"base_controller.period" = { values = [0.5, 2.0], relative = true, not_in = ["fast"] }
"base_controller.damping[4:6]" = { values = [1.0, 3.0] }
"manipulator_controller.observer" = ["paper"]
"""


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("varied")
    (directory / "some.toml").write_text(SWEEP)
    (directory / "evaluation.py").write_text(EVALUATION)
    arguments = ["--workers", "2", "--out", str(directory / "out")]
    assert command.call(["sweep", str(directory / "some.toml"), *arguments]) == 0
    return directory / "out"


def test_each_design_changes_one_axis_and_the_first_design_none(swept: Path) -> None:
    frame = pandas.read_parquet(swept / "results.parquet")
    assert len(frame) == 12
    axes = [name for name in frame.columns if "controller." in name]
    assert list(frame[axes].notna().sum(axis=1)) == [0, 0, *[1] * 10]
    slow = frame[frame["case"] == "slow"].reset_index()
    assert list(slow["base_controller.period"].dropna()) == [0.5, 2.0]
    assert list(slow["manipulator_controller.observer"].dropna()) == ["paper"]


def test_an_axis_does_not_change_the_cases_in_not_in(swept: Path) -> None:
    frame = pandas.read_parquet(swept / "results.parquet")
    fast = frame[frame["case"] == "fast"].reset_index()
    columns = ["largest_energy", "base_position_error_m_max"]
    assert (fast.loc[1:2, columns].to_numpy() == fast.loc[0, columns].to_numpy()).all()
    slow = frame[frame["case"] == "slow"].reset_index()
    assert slow.loc[0, columns[1]] != slow.loc[2, columns[1]]


def test_named_designs_are_run_in_every_case_and_do_not_change_what_a_case_sets(
    tmp_path: Path,
) -> None:
    text = SWEEP[: SWEEP.index("[vary]")].replace('evaluation = "evaluation.py:mine"\n', "")
    designs = '[designs.slow]\n"base_controller.period" = 0.5\n[designs."one push"]\nstop_s = 2\n'
    (tmp_path / "some.toml").write_text(text + designs)
    out = str(tmp_path / "out")
    assert command.call(["sweep", str(tmp_path / "some.toml"), "--workers", "1", "--out", out]) == 0
    frame = pandas.read_parquet(tmp_path / "out" / "results.parquet")
    assert list(frame["design_name"]) == ["slow", "slow", "one push", "one push"]
    assert list(frame["simulated_s"]) == [1.0, 1.0, 2.0, 2.0]
    assert not frame["failed"].any()


def test_a_csv_file_of_a_design_is_beside_the_sweep_and_its_numbers_are_in_the_plan(
    tmp_path: Path,
) -> None:
    (tmp_path / "path.csv").write_text("t,x\n0,0\n2,0.1\n")
    (tmp_path / "some.toml").write_text(
        'scenario = "multirate_passive"\n'
        '[designs.a]\n"reference_trajectory.waypoint" = { csv = "path.csv" }\n'
    )
    found = sweep_file.read(str(tmp_path / "some.toml")).designs
    assert isinstance(found, NamedDesigns)
    assert found.settings["a"] == {
        "reference_trajectory.waypoint_t": {"first": [0.0, 2.0]},
        "reference_trajectory.waypoint_x": {"first": [0.0, 0.1]},
    }


def test_an_evaluation_adds_columns_prints_and_writes_its_files(
    swept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = pandas.read_parquet(swept / "results.parquet")
    assert (frame["largest_energy"] > 0.0).all()
    assert frame.attrs["units"]["largest_energy"] == "J"
    assert (swept / "mine.txt").read_text().startswith("12 ['base_controller.period'")
    file = swept.parent / "some.toml"
    assert command.call(["sweep", str(file), "--out", str(swept)]) == 0
    assert "largest of all: " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '[vary]\n"stop_s" = [1]\n[grid]\n"base_controller.period" = [0.1]',
            "[vary] changes one parameter at a time; remove [vary], or remove [grid], [sample]",
        ),
        (
            '[vary]\n"base_controller.period" = { values = [0.1], not_in = ["fast"] }',
            "base_controller.period: not_in has 'fast', which is not a case",
        ),
        (
            '[vary]\n"base_controller.period" = { values = [0.1], not_in = "fast" }',
            "not_in is 'fast'; a list of names of cases is expected",
        ),
        (
            'evaluation = "mine.py"\n[vary]\n"stop_s" = [1]',
            "evaluation is 'mine.py'; 'FILE.py:OBJECT'",
        ),
        ('evaluation = "no.py:mine"\n[vary]\n"stop_s" = [1]', "no.py does not exist"),
        (
            'evaluation = "math:pi"\n[vary]\n"stop_s" = [1]',
            "evaluation math:pi has no 'signals'; signals, columns, measure and report are expected",
        ),
        (
            'evaluation = "math:tau2"\n[vary]\n"stop_s" = [1]',
            "math:tau2 cannot be used: AttributeError",
        ),
        ('[vary]\n"base_controller.perid" = [0.1]', "did you mean 'period'"),
        (
            '[designs.a]\n"stop_s" = 1\n[grid]\n"stop_s" = [1]',
            "[designs.NAME] lists all designs; remove these tables, or remove [grid], [sample], [vary]",
        ),
        ('[designs."a b"]\n"base_controller.perid" = 1', "did you mean 'period'"),
        ("[designs]\na = 1", "designs.a: a table of targets and values is expected"),
        ("designs = 3", "'designs' is 3; a table is expected"),
        (
            'evaluation = "freeflyer.paper.sensitivity:evaluation"\nset = ["stop_s=0.1"]\n[vary]\n"stop_s" = [0.2]',
            "the statements need the cases continuous, unstable, passive; [cases.continuous] is missing",
        ),
    ],
    ids=str,
)
def test_mistakes_are_rejected_with_one_sentence(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, message: str
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(f'scenario = "multirate_passive"\n{text}')
    code, error = run_command(capsys, "sweep", str(file), "--out", str(tmp_path / "out"))
    assert code == 2
    assert message in error


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '"largest_energy": float(',
            '"largest_energi": float(',
            "the evaluation measured largest_energi; its",
        ),
        ("float(result", "str(result", "the evaluation measured largest_energy = '"),
    ],
)
def test_a_wrong_measurement_is_a_failed_row_with_its_cause(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    (tmp_path / "some.toml").write_text(SWEEP.replace('"manipulator', '#"manipulator'))
    text = EVALUATION.replace(old, new).replace(
        "max(row['largest_energy'] for row in rows):.3g", "1"
    )
    (tmp_path / "evaluation.py").write_text(text)
    out = str(tmp_path / "out")
    assert command.call(["sweep", str(tmp_path / "some.toml"), "--workers", "1", "--out", out]) == 0
    frame = pandas.read_parquet(tmp_path / "out" / "results.parquet")
    assert frame["failed"].all()
    assert frame["cause"].str.contains(message, regex=False).all()


def test_a_column_of_the_results_cannot_be_measured_again(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "some.toml").write_text(SWEEP)
    (tmp_path / "evaluation.py").write_text(EVALUATION.replace("largest_energy", "stable"))
    code, error = run_command(capsys, "sweep", str(tmp_path / "some.toml"), "--out", str(tmp_path))
    assert code == 2
    assert "the evaluation has a column 'stable', which the results have already" in error


def test_errors_of_an_evaluation_are_rows_and_one_sentence(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """`measure` fails in every run. Then `report` compares values that are None."""
    (tmp_path / "some.toml").write_text(SWEEP)
    bad = EVALUATION.replace('"free_flyer.kinetic_energy"].max', '"free_flyer.no"].max')
    (tmp_path / "evaluation.py").write_text(bad)
    out = tmp_path / "out"
    code, error = run_command(capsys, "sweep", str(tmp_path / "some.toml"), "--out", str(out))
    assert code == 2
    assert "evaluation.py:mine cannot report the results" in error
    assert "TypeError" in error
    frame = pandas.read_parquet(out / "results.parquet")
    assert frame["failed"].all()
    assert frame["cause"].str.contains("has no signal 'free_flyer.no'").all()
