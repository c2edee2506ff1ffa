"""The functions of the three packages, as a script uses them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import freeflyer as ff
from freeflyer_adapters import DeviceError, VirtualFacility
from freeflyer_fmus import BlockError, InProcessBlock


def test_a_changed_scenario_is_the_scenario_with_these_changes() -> None:
    changes = {"base_controller.period": 0.1, "manipulator_controller.observer": "tracking"}
    loop = ff.load("multirate_passive", {"stop_s": 1.0})
    assert (
        loop.changed(changes).source
        == ff.load("multirate_passive", {"stop_s": 1.0, **changes}).source
    )
    assert loop.changed({}) == loop
    arrays = loop.changed({"base_controller.damping": np.full(6, 3.0)})
    assert arrays.source == loop.changed({"base_controller.damping": [3.0] * 6}).source


MISTAKES: dict[str, tuple[object, str]] = {
    "misspelt parameter": ({"base_controller.perod": 0.1}, "did you mean 'period'?"),
    "misspelt component": ({"base_controler.period": 0.1}, "did you mean 'base_controller'?"),
    "unit that does not fit": ({"base_controller.period": "0.1 m"}, "m"),
    "wrong type": ({"base_controller.period": object()}, "of type object; a number"),
    "wrong type inside": ({"base_controller.damping": [1.0, None]}, "of type NoneType; a number"),
    "text instead of a mapping": ("stop_s=1", "a mapping"),
    "number instead of a mapping": (3, "a mapping"),
    "number as a name": ({1: 2.0}, "a mapping"),
    "wrong size": ({"base_controller.damping": [1.0, 2.0]}, "2"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_exception_with_one_sentence(mistake: str) -> None:
    changes, expected = MISTAKES[mistake]
    with pytest.raises(ff.CosimError) as found:
        ff.run(ff.load("multirate_passive", {"stop_s": 1.0}), changes)  # type: ignore[arg-type]
    assert expected in str(found.value)
    assert "\n" not in str(found.value)


def test_a_text_with_a_unit_is_a_value_everywhere(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        'extends = "robust"\n[components.base_controller.parameters]\nperiod = "500 ms"\n'
    )
    assert ff.parameters(str(file), {"stop_s": "1 s"})["base_controller.period"] == 0.5
    assert ff.load("robust", {"stop_s": "500 ms"}).stop == 500_000_000
    with pytest.raises(ff.CosimError, match="did you mean 'stop_s'"):
        ff.load("robust", {"stop": 3.0})
    file.write_text('extends = "robust"\n[components.base_contoller.parameters]\nperiod = 0.5\n')
    with pytest.raises(ff.CosimError, match="did you mean 'base_controller'"):
        ff.load(str(file))


def test_a_scenario_shares_no_table_with_another_one() -> None:
    ff.load("multirate_passive").components[0].parameters["bogus"] = 1  # type: ignore[index]
    assert not ff.load("multirate_passive").components[0].parameters


def test_the_last_progress_is_the_simulated_time() -> None:
    seen: list[float] = []
    run = ff.run("multirate_passive", {"stop_s": 1.0}, progress=seen.append)
    assert seen[-1] == run.outcome.simulated == 1.0
    wrench = run.record["base_controller.base_wrench"]
    assert np.array_equal(run.record["base_controller.base_wrench[2]"], wrench[:, 1])


def test_results_do_not_need_their_files(tmp_path: Path) -> None:
    ff.write_ssp(ff.load("multirate_passive", {"stop_s": 1.0}), tmp_path / "loop.ssp")
    run = ff.run(ff.load_ssp(tmp_path / "loop.ssp"))
    (tmp_path / "loop.ssp").unlink()
    again = ff.run(run.scenario, {"stop_s": 0.5})  # the unpacked FMUs live as long as the scenario
    assert again.verdict == "completed"
    assert again.record.rows < run.record.rows
    audit = ff.audit(run)
    assert "port B" in repr(audit)
    assert "<table>" in audit._repr_html_()


def test_a_record_as_table_and_as_dataset_has_names_and_units() -> None:
    record = ff.run("multirate_passive", {"stop_s": 0.5}).record
    dataset = record.to_xarray()
    assert dataset["free_flyer.base_velocity"].attrs["units"][:1] == ["m/s"]
    assert np.array_equal(dataset["free_flyer.base_position"], record["free_flyer.base_position"])
    assert record.to_pandas().attrs["units"]["time"] == "s"


def test_titles_are_escaped_in_a_notebook() -> None:
    table = ff.Table(title="<b>", header=("", "a"), rows=[("x", "<1")])
    assert "<b>" not in table._repr_html_()
    assert "&lt;1" in table._repr_html_()
    assert str(table).splitlines()[0] == "<b>"


SCRIPT = """
import freeflyer as ff
made = ff.sweep(
    {"scenario": "multirate_unstable", "set": ["stop_s=1"], "grid": {"base_controller.period": [0.1, 0.2]}},
    directory="scan", workers=1,
)
print(len(made.runs), "runs", __name__)
"""


def test_a_script_without_a_main_guard_runs_a_sweep_once(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stdout) == (0, "2 runs __main__\n"), done.stderr
    assert (tmp_path / "scan" / "results.parquet").is_file()


@pytest.mark.parametrize("name", ["free_flyer", "base_controller"])
def test_the_linearisation_of_a_block_is_the_derivative_of_its_evaluation(name: str) -> None:
    block = InProcessBlock(name)
    block.start()
    if name == "base_controller":  # the inputs of another posture, so that no entry is zero
        block.set("joint_position", [0.1, 0.2, -1.4, 0.2, -1.3, 0.1])
        block.set("base_velocity", [0.01, -0.02, 0.03, 0.01, 0.02, -0.01])
    found = block.linearise()
    inputs = [v.name for v in block.block.having("input")]
    u0 = np.concatenate([block.value(n).copy() for n in inputs])

    def results(u: np.ndarray) -> np.ndarray:
        ends = np.cumsum([block.value(n).size for n in inputs])[:-1]
        for n, part in zip(inputs, np.split(u, ends), strict=True):
            block.set(n, part)
        outputs = [v.name for v in block.block.having("output")]
        block.start()
        parts = [block.value(n).copy() for n in outputs]
        return np.concatenate([block.rates(), *parts] if not block.block.is_sampled else parts)

    h = 1e-6
    matrix = np.array(
        [(results(u0 + h * e) - results(u0 - h * e)) / (2 * h) for e in np.eye(u0.size)]
    ).T
    exact = found.D if block.block.is_sampled else np.vstack([found.B, found.D])
    assert np.abs(matrix - exact).max() < 1e-5 * max(1.0, np.abs(exact).max())


def test_mistakes_with_a_block_are_one_sentence() -> None:
    with pytest.raises(BlockError, match="did you mean 'free_flyer'"):
        InProcessBlock("free_flier")
    plant = InProcessBlock("free_flyer")
    with pytest.raises(BlockError, match="did you mean 'joint_torque'"):
        plant.set("joint_torqe", 0.0)
    with pytest.raises(ff.ComponentError, match="5 numbers; 6 are expected"):
        plant.set("joint_torque", [0.0] * 5)
    with pytest.raises(BlockError, match="is sampled and has no derivatives"):
        InProcessBlock("base_controller").derivatives(0.0, np.zeros(6))


def test_a_facility_that_cannot_start_gives_the_reason() -> None:
    with pytest.raises(DeviceError, match=r"has no \[devices.NAME\]"), VirtualFacility("robust"):
        pass
    with pytest.raises(ff.CosimError, match="a mapping"):
        VirtualFacility("facility", "devices.arm_drive.channel=x")
