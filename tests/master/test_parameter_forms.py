"""Forms of a parameter value in a scenario: first elements, parts of a choice, columns of a CSV."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run_command

from freeflyer.scenario import experiment, scenario
from freeflyer.scenario.assemble import assembled

WAYPOINTS = "t, x, y\n0, 0, 0\n1.5, 0.1, 0\n\n3, 0.1, 0.05\n"
HEAD = """
extends = "multirate_passive"
stop_s = 1
[components.reference_trajectory]
fmu = "waypoint_trajectory"
[components.reference_trajectory.parameters]
"""


def written(folder: Path, text: str, name: str = "mine.toml") -> str:
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(text)
    return str(folder / name)


def values(path: str, *settings: str) -> dict[str, Any]:
    with assembled(scenario.load(path, settings)) as (_, found):
        return {f"{c}.{p}": v for c, parameters in found.items() for p, v in parameters.items()}


def test_a_csv_file_sets_one_parameter_for_each_column(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text(WAYPOINTS)
    found = values(written(tmp_path, HEAD + 'waypoint = { csv = "path.csv" }'))
    assert list(found["reference_trajectory.waypoint_t"][:4]) == [0.0, 1.5, 3.0, -1.0]
    assert list(found["reference_trajectory.waypoint_y"][:4]) == [0.0, 0.0, 0.05, 0.0]
    assert "reference_trajectory.waypoint_z" not in found


def test_a_path_is_relative_to_the_file_that_has_it(tmp_path: Path) -> None:
    (tmp_path / "base").mkdir()
    (tmp_path / "base" / "path.csv").write_text(WAYPOINTS)
    written(tmp_path / "base", HEAD + 'waypoint = { csv = "path.csv" }')
    path = written(tmp_path / "other", 'extends = "../base/mine.toml"')
    assert values(path)["reference_trajectory.waypoint_x"][1] == 0.1
    # A file may replace the CSV file of the scenario that it extends.
    (tmp_path / "other" / "mine.csv").write_text("t,x\n0,0\n2,0.3\n")
    more = '[components.reference_trajectory.parameters]\nwaypoint = { csv = "mine.csv" }'
    path = written(tmp_path / "other", f'extends = "../base/mine.toml"\n{more}')
    found = values(path)
    assert list(found["reference_trajectory.waypoint_x"][:3]) == [0.0, 0.3, 0.0]
    assert list(found["reference_trajectory.waypoint_t"][:3]) == [0.0, 2.0, -1.0]
    assert "reference_trajectory.waypoint_y" not in found


def test_a_path_in_a_setting_is_relative_to_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "path.csv").write_text(WAYPOINTS)
    monkeypatch.chdir(tmp_path / "here")
    path = written(tmp_path, HEAD)
    found = values(path, 'reference_trajectory.waypoint={csv="path.csv"}')
    assert found["reference_trajectory.waypoint_t"][2] == 3.0


def test_the_waypoints_are_in_the_record_and_the_end_effector_follows_them(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text(WAYPOINTS)
    path = written(tmp_path, HEAD + 'waypoint = { csv = "path.csv" }')
    result = experiment.run(scenario.load(path, ["stop_s=4"]))
    record = result.outcome.record
    assert record.provenance is not None
    stored = record.provenance.parameters["reference_trajectory"]
    assert stored["waypoint_y"][:3] == [0.0, 0.0, 0.05]
    moved = record["free_flyer.end_effector_position"]
    assert moved[-1] - moved[0] == pytest.approx([0.1, 0.05, 0.0], abs=1e-4)


def test_the_first_elements_of_a_vector_can_be_set(tmp_path: Path) -> None:
    text = 'extends = "multirate_passive"\n[components.base_controller.parameters]\n'
    found = values(written(tmp_path, text + "stiffness = { first = [1, 2] }"))
    assert list(found["base_controller.stiffness"]) == [1.0, 2.0, 150.0, 40.0, 40.0, 40.0]


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ('{ manipulator = "applied", base = "as_printed" }', 3),
        ('{ base = "as_printed", manipulator = "applied" }', 3),
        ('{ manipulator = "as_printed", base = "applied" }', 4),
        ('{ manipulator = "as_printed", base = "as_printed" }', 1),
        ('"manipulator_applied_base_as_printed"', 3),
    ],
)
def test_both_controllers_get_the_bookkeeping_of_each_port(
    tmp_path: Path, text: str, number: int
) -> None:
    head = 'extends = "multirate_passive"\n[components.manipulator_controller.parameters]\n'
    found = values(written(tmp_path, f"{head}bookkeeping = {text}"))
    both = [found[f"{name}_controller.bookkeeping"] for name in ("manipulator", "base")]
    assert np.array_equal(both, [[number], [number]])


@pytest.mark.parametrize(
    ("csv", "message"),
    [
        (None, "path.csv cannot be read: No such file or directory"),
        ("", "has the first line ''; different names of columns are expected"),
        ("t,x\n", "has the first line 't,x'; different names of columns are expected"),
        ("0,1\n1,2\n", "different names of columns are expected there, and numbers"),
        ("t,t\n1,2\n", "has the first line 't,t'; different names"),
        ("t,x\n1,two\n", "line 2 of "),
        ("t,x\n1,2\n3\n", "is '3'; 2 numbers are expected"),
        ("t,x\n1,nan\n", "is '1,nan'; 2 numbers are expected"),
        ("t,x\n\n\n1,2\n3,1_0\n", "line 5 of "),
        ("x,y\n0.1,0.1\n", "give each waypoint a time (column t)"),
        ("t,x\n0,0\n0,0.1\n", "sort the waypoints by time"),
        ("t,roll\n0,1\n", "has no parameter 'waypoint_roll'"),
        (
            "t,x\n" + "1,2\n" * 33,
            "waypoint_t has 33 values in 'first'; a list of 1 to 32 values is expected",
        ),
        ("t,x\n0,0\n2,1\n1,1\n", "sort the waypoints by time"),
        (b"\xff\xfe\x00t", "cannot be read: "),
        ('t,"x\n1,2\n', "different names of columns are expected"),
    ],
    ids=str,
)
def test_a_wrong_csv_file_gives_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], csv: str | bytes | None, message: str
) -> None:
    if csv is not None:
        (tmp_path / "path.csv").write_bytes(csv if isinstance(csv, bytes) else csv.encode())
    path = written(tmp_path, HEAD + 'waypoint = { csv = "path.csv" }')
    code, error = run_command(capsys, "run", path, "--out", str(tmp_path / "out"))
    assert code == 2
    assert message in error


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ('base_controller.stiffness={ csv = "/dev/zero" }', "/dev/zero is not a regular file"),
        ('base_controller.stiffness={ csv = "/" }', "/ is not a regular file"),
        ('base_controller.stiffness={ csv = 3 }', '{ csv = "FILE" } is expected'),
        ('base_controller.stiffness={ csv = "a", x = 1 }', '{ csv = "FILE" } is expected'),
        ("base_controller.stiffness={ first = [] }", "has 0 values in 'first'; a list of 1 to 6"),
        ("base_controller.stiffness={ first = 3 }", "has 3 in 'first'; a list of 1 to 6 values is expected"),
        ("base_controller.stiffness={ first = ['a'] }", "6 numbers in N/m are expected"),
        ("base_controller.stiffness={ one = [1] }", "{ value = ..., unit = ... } is expected"),
        ('base_controller.discretisation={ base = "matched" }', "one of emulated, matched is expected, or a table of the parts"),
        ('manipulator_controller.bookkeeping={ base = "applied" }', "one of as_printed, applied"),
        ('manipulator_controller.bookkeeping={ bass = "applied", manipulator = "applied" }', "one of"),
        ('manipulator_controller.bookkeeping={ base = "appl", manipulator = "applied" }', "one of"),
        ("base_controller.theta=0.4", "parameter theta is 0.4; at least 0.5 is expected"),
        ("base_controller.theta=1.2", "choose theta from 0.5 to 1"),
        ("free_flyer.integration_step=0", "parameter integration_step is 0; at least 1e-06"),
        ("reference_trajectory.shape=square", "one of sine, hold, line, circle is expected"),
        ("reference_trajectory.fade_out_time=0", "parameter fade_out_time is 0"),
    ],
)  # fmt: skip
def test_a_wrong_value_gives_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], setting: str, message: str
) -> None:
    out = str(tmp_path / "out")
    arguments = ["run", "multirate_passive", "--set", setting, "--set", "stop_s=0.1", "--out", out]
    code, error = run_command(capsys, *arguments)
    assert code == 2
    assert message in error
