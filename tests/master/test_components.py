"""Components of any kind: FMI 2.0, FMI 3.0, in-process block, Python object; their parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from freeflyer.master.record import Record
from freeflyer.scenario import experiment, scenario

SHORT = 'extends = "multirate_passive"\nstop_s = 1.2\n'


def record_of(tmp_path: Path, text: str, *overrides: str, fmi: int | None = None) -> Record:
    path = tmp_path / "mine.toml"
    path.write_text(SHORT + text)
    result = experiment.run(scenario.load(str(path), overrides), fmi=fmi)
    assert not result.outcome.diverged, result.outcome.cause
    return result.outcome.record


def same(one: Record, other: Record, tolerance: float) -> None:
    for name in one.signals:
        assert np.abs(one[name] - other[name]).max() <= tolerance * max(
            1.0, np.abs(one[name]).max()
        ), name


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Record:
    return record_of(tmp_path_factory.mktemp("reference"), "")


def test_fmi_3_gives_a_bit_identical_record(tmp_path: Path, reference: Record) -> None:
    same(reference, record_of(tmp_path, "", fmi=3), 0.0)


@pytest.mark.parametrize(
    "name", ["free_flyer", "manipulator_controller", "base_controller", "reference_trajectory"]
)
def test_an_in_process_block_replaces_an_fmu(tmp_path: Path, reference: Record, name: str) -> None:
    same(reference, record_of(tmp_path, f'[components.{name}]\nkind = "twin"\n'), 1e-9)


def test_a_python_object_replaces_an_fmu(tmp_path: Path, reference: Record) -> None:
    start = {
        name: tuple(map(float, reference[f"reference_trajectory.{name}"][0]))
        for name in ("position", "orientation")
    }
    (tmp_path / "still.py").write_text(
        f"START = {start!r}\n"
        "from freeflyer.fmi.component import Port, PythonComponent\n"
        "class Still(PythonComponent):\n"
        "    def __init__(self, name):\n"
        "        def port(name, size, start, units):\n"
        "            return Port(name=name, size=size, causality='output', units=units, start=start)\n"
        "        p = (0.0,) * 6\n"
        "        super().__init__(name, [port('position', 3, START['position'], ('m',) * 3), port('orientation', 4, START['orientation'], ('1',) * 4),\n"
        "            port('velocity', 6, p, (None,) * 6), port('acceleration', 6, p, (None,) * 6)])\n"
        "    def advance(self, time, size):\n"
        "        pass\n"
    )
    record = record_of(
        tmp_path,
        '[components.reference_trajectory]\nkind = "python"\nobject = "still.py:Still"\nstep_s = 0.3\n',
    )
    assert np.ptp(record["reference_trajectory.position"], axis=0).max() == 0.0
    assert (
        np.abs(record["free_flyer.end_effector_velocity"]).max()
        < 1e-9
        < np.abs(reference["free_flyer.end_effector_velocity"]).max()
    )


def test_a_robot_parameter_affects_plant_and_controllers_and_set_affects_one_component(
    tmp_path: Path, reference: Record
) -> None:
    both = record_of(tmp_path, "[robot]\ntool_mass = 2.0\n")
    only_plant = record_of(tmp_path, "", "free_flyer.tool_mass=2.0")
    position = "free_flyer.end_effector_position"
    error = {
        name: np.linalg.norm(
            record[position] - record["reference_trajectory.position"], axis=1
        ).max()
        for name, record in (("none", reference), ("both", both), ("plant", only_plant))
    }
    assert error["both"] < 5 * error["none"]
    assert error["plant"] > 20 * error["none"]


def test_values_with_units_are_converted(tmp_path: Path) -> None:
    text = (
        "[components.free_flyer.parameters]\nbase_position = { value = [1, 2, 3], unit = 'mm' }\n"
    )
    assert record_of(tmp_path, text)["free_flyer.base_position"][0] == pytest.approx(
        [0.001, 0.002, 0.003]
    )
    record = record_of(
        tmp_path, "", "base_controller.period=100 ms", "free_flyer.base_mass=150000 g"
    )
    assert (np.diff(record["base_controller.base_wrench"][:, 0]) != 0).sum() <= 12


def test_a_controller_samples_the_plant_state_recorded_at_the_same_instant(
    reference: Record,
) -> None:
    """In the record, F_b changes only at the base controller's samples."""
    rows = np.isclose(np.round(reference.time / 0.3) * 0.3, reference.time, atol=1e-9)
    held = reference["base_controller.base_wrench"]
    changes = np.flatnonzero(np.abs(np.diff(held, axis=0)).max(axis=1) > 0.0) + 1
    assert set(changes) <= set(np.flatnonzero(rows))
    assert len(changes) >= 3


@pytest.mark.parametrize("name", scenario.shipped())
def test_the_source_text_of_a_scenario_loads_as_an_equal_scenario(
    tmp_path: Path, name: str
) -> None:
    shipped = scenario.load(name)
    path = tmp_path / f"{name}.toml"
    path.write_text(shipped.source)
    again = scenario.load(str(path))
    for field in (
        "title",
        "stop",
        "expect",
        "components",
        "connections",
        "limits",
        "errors",
        "observed_energy",
    ):
        assert getattr(again, field) == getattr(shipped, field), field
