"""Axes whose values have units are numbers in the unit of the parameter."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.analysis.sweep import results, task
from freeflyer.analysis.sweep.plan import Plan
from freeflyer.analysis.sweep.results import Results
from freeflyer.foundation.errors import CosimError

STIFFNESS = "base_controller.stiffness[1:3]"


def planned(**tables: Any) -> Plan:
    return Plan(sweep_file.read({"scenario": "multirate_passive", "set": ["stop_s=0.6"], **tables}))


def column(plan: Plan, name: str) -> list[Any]:
    place = [str(axis.target) for axis in plan.axes].index(name)
    return [plan.design(number)[2][place] for number in range(len(plan))]


@pytest.mark.parametrize(
    ("target", "values", "numbers", "unit"),
    [
        ("base_controller.period", ["100 ms", "0.2 s", 0.3], [0.1, 0.2, 0.3], "s"),
        ("base_controller.period", [{"value": 300, "unit": "ms"}], [0.3], "s"),
        ("stop_s", ["600 ms", "0.01 min"], [0.6, 0.6], "s"),
        ("record.every_s", ["10 ms"], [0.01], "s"),
        ("free_flyer.step_s", ["1 ms"], [0.001], "s"),
        ("robot.base_mass", ["0.15 t", 160], [150.0, 160], "kg"),
        (STIFFNESS, ["1 N/m", "0.1 N/mm"], [1.0, 100.0], "N/m"),
    ],
)
def test_the_values_of_an_axis_are_numbers_in_the_unit_of_its_parameter(
    target: str, values: list[Any], numbers: list[float], unit: str
) -> None:
    for tables in ({"grid": {target: values}}, {"vary": {target: values}}):
        plan = planned(**tables)
        found = [value for value in column(plan, target) if value is not None]
        assert found == numbers
        field = results.schema(plan).field(target)
        assert (field.type, field.metadata) == (pa.float64(), {b"unit": unit.encode()})


def test_the_runs_use_the_values(tmp_path: Path) -> None:
    plan = planned(grid={"base_controller.period": ["100 ms", "0.2 s"]})
    found = Results(tmp_path, plan)
    with found.opened():
        found.add([task.row(plan.setup, plan.run(number)) for number in range(2)])
        table = found.write()
    assert table.column("base_controller.period").to_pylist() == [0.1, 0.2]
    assert table.column("failed").to_pylist() == [False, False]
    assert [plan.run(number).assignments[0][1] for number in range(2)] == [
        {"value": 0.1, "unit": "s"},
        {"value": 0.2, "unit": "s"},
    ]


def test_a_sample_has_numbers_too_and_other_targets_get_the_same_value() -> None:
    axis = {"values": ["100 ms"], "also": ["manipulator_controller.base_period"]}
    plan = planned(sample={"count": 2, "parameters": {"base_controller.period": axis}})
    assert column(plan, "base_controller.period") == [0.1, 0.1]
    assert [value for _, value in plan.run(0).assignments] == [{"value": 0.1, "unit": "s"}] * 2


def test_the_values_of_enumerations_stay_texts() -> None:
    plan = planned(grid={"manipulator_controller.observer": ["paper", "port"]})
    assert column(plan, "manipulator_controller.observer") == ["paper", "port"]
    assert results.schema(plan).field("manipulator_controller.observer").type == pa.string()


def test_an_axis_with_units_can_be_an_axis_of_the_map() -> None:
    grid = {"base_controller.period": ["100 ms", "0.2 s"], "robot.base_mass": ["150 kg", "0.2 t"]}
    axes = {"x": "base_controller.period", "y": "robot.base_mass", "predict": False}
    plan = planned(grid=grid, map=axes)
    assert plan.levels("base_controller.period") == (0.1, 0.2)


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ({"base_controller.period": ["1 kg"]}, "unit 'kg' cannot be converted to 's'; s is expec"),
        ({STIFFNESS: ["1 mm"]}, "[1:3]: unit 'mm' cannot be converted to 'N/m'; N/m is expected"),
        ({"free_flyer.base_orientation[1]": ["1 mm"]}, "a number without unit is expected"),
        ({"exchange": ["5 ms"]}, "exchange is 5 ms; 'sequential' or 'parallel' is expected"),
        ({"manipulator_controller.observer": ["5 ms"]}, "observer is 5 ms; one of paper, port"),
        ({"base_controller.period": {"first": "1 ms", "last": 2, "count": 2}}, "the key 'unit'"),
        ({"": [1]}, "[grid] '': NAME, NAME[k] or NAME[first:last] is expected"),
    ],
)
def test_a_wrong_unit_is_one_sentence(grid: dict[str, Any], message: str) -> None:
    with pytest.raises(CosimError) as caught:
        planned(grid=grid)
    assert message in str(caught.value)
    assert "{" not in str(caught.value)


def test_the_path_of_a_csv_file_in_set_is_relative_to_the_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    (tmp_path / "mine.toml").write_text(
        'scenario = "multirate_passive"\nset = ["base_controller.p={ csv = \'f.csv\' }"]\n[grid]\nstop_s = [1]\n'
    )
    (tmp_path / "f.csv").write_text("x\n1\n")
    with pytest.raises(CosimError, match="has no parameter 'p_x'"):  # the file has been read
        Plan(sweep_file.read(tmp_path / "mine.toml"))


# Sizes


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"grid": {"a.b": {"first": 1, "last": 2, "count": 10**9}}}, "and at most 10000"),
        ({"sample": {"count": 10**9, "parameters": {"a.b": [1]}}}, "from 1 to 1000000 is expected"),
        (
            {"grid": {f"a.b{k}": {"first": 1, "last": 2, "count": 9999} for k in range(6)}},
            "the sweep has 999400149980001499940001 runs; at most 1000000 are expected",
        ),
        (
            {
                "cases": {"one": {}, "two": {}},
                "sample": {"count": 600_000, "parameters": {"a.b": [1]}},
            },
            "the sweep has 1200000 runs; at most 1000000 are expected, so use fewer values or cases",
        ),
    ],
)
def test_a_sweep_with_too_many_runs_is_rejected(tables: dict[str, Any], message: str) -> None:
    with pytest.raises(CosimError) as caught:
        sweep_file.read({"scenario": "multirate_passive", **tables})
    assert message in str(caught.value)
