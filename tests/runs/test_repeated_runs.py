"""A run is described completely, repeated with the same bits, listed and compared."""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_processes import SCENARIO, SHORT, WHOLE, incomplete, names

import freeflyer as ff
from freeflyer.cli import main as command
from freeflyer.foundation.errors import CosimError, OutputError, RecordError
from freeflyer.scenario.run_directory import RunDirectory
from freeflyer.scenario.summary_file import sealed


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def output(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert command.call([str(one) for one in arguments]) == 0
    return capsys.readouterr().out


def test_a_summary_has_everything_that_is_needed_to_repeat_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["run", SCENARIO, "--set", "stop_s=0.5", "--set", "base_controller.period=100 ms", "--out", "out"]  # fmt: skip
    monkeypatch.setattr(sys, "argv", ["freeflyer", *arguments])
    assert command.call(arguments) == 0
    summary = json.loads(Path("out/summary.json").read_text())
    run = summary["run"]
    assert run["command"] == ["freeflyer", *arguments]
    assert run["working_directory"] == str(tmp_path)
    assert run["changes"] == ["stop_s=0.5", "base_controller.period=100 ms"]
    assert {"host", "processor", "cores"} <= run["machine"].keys()
    assert {"python", "platform", "freeflyer-cosim", "numpy"} <= summary["versions"].keys()
    # All parameters, also those that the scenario does not set, and the changed one in its unit.
    assert run["parameters"]["base_controller"]["period"] == 0.1
    assert run["parameters"]["free_flyer"]["base_mass"] == 150.0
    assert "period = " in run["scenario"]
    assert "stop_s = 0.5" in run["scenario"]
    components = set(run["parameters"])
    assert set(run["tokens"]) == set(run["files"]) == components
    assert all(len(digest) == 64 for digest in run["files"].values())
    assert summary["run"]["started"].endswith("+00:00")


def test_seeds_are_parameters_of_the_run(tmp_path: Path) -> None:
    (tmp_path / "noisy.toml").write_text('extends = "facility"\nstop_s = 0.05\n')
    result = ff.run(tmp_path / "noisy.toml", directory=tmp_path / "out")
    parameters = result.summary["run"]["parameters"]
    seeds = {f"{name}.{key}": value for name, own in parameters.items() for key, value in own.items() if "seed" in key}  # fmt: skip
    assert seeds
    name, seed = next(iter(seeds.items()))
    other = ff.run(tmp_path / "out", {name: int(seed) + 1})
    assert any(line.startswith(f"parameter {name}: ") for line in result.differences(other))
    (tmp_path / "noisy.toml").unlink()
    assert result.differences(ff.run(tmp_path / "out")) == []


@pytest.mark.parametrize("engine", ["core", "python"])
def test_a_run_is_repeated_with_the_same_bits(
    engine: str, capsys: pytest.CaptureFixture[str]
) -> None:
    changes = ("--set", "stop_s=0.5", "--set", "base_controller.period=0.1")
    output(capsys, "run", SCENARIO, *changes, "--out", "out")
    text = output(capsys, "run", "out", "--master", engine)
    assert "Same bits as" in text
    link = Path("freeflyer_out", SCENARIO)
    first, second = ff.open_run("out"), ff.open_run(link)
    assert first.record.digest == second.record.digest
    assert second.summary["run"]["changes"] == ["stop_s=0.5", "base_controller.period=0.1"]
    # A repetition is repeated, and the link leads to the new run only afterwards.
    text = output(capsys, "run", link, "--set", "base_controller.period=0.2")
    assert "Different from" in text
    assert "parameter base_controller.period: 0.1 and 0.2" in text
    assert " most, by up to " in text
    assert names(Path("out")) == WHOLE


def test_what_differs_is_named(tmp_path: Path) -> None:
    first = ff.run(SCENARIO, SHORT, directory=tmp_path / "one")
    shutil.copytree(tmp_path / "one", tmp_path / "two")
    summary = json.loads((tmp_path / "two" / "summary.json").read_text())
    summary["versions"]["numpy"] = "1.0"
    summary["run"]["machine"]["processor"] = "another one"
    summary["run"]["files"]["free_flyer"] = "0" * 64
    summary["run"]["engine"] = "python"
    record = ff.run(SCENARIO, {"stop_s": 0.6}).record
    record.write(tmp_path / "two" / "record.parquet")
    summary["run"]["record_sha256"] = record.digest
    del summary["sha256"]
    (tmp_path / "two" / "summary.json").write_text(json.dumps(sealed(summary)))
    text = "\n".join(first.differences(ff.open_run(tmp_path / "two")))
    for part in (
        "version of numpy: ",
        "machine: processor: ",
        "the files of component free_flyer are not the same",
        "engine: 'core' and 'python'",
        "the records have 51 and 61 rows, up to 0.5 and 0.6 s",
    ):
        assert part in text


def test_an_opened_run_is_the_result_of_the_run(tmp_path: Path) -> None:
    result = ff.run(SCENARIO, SHORT)
    path = result.save(tmp_path / "out")
    again = ff.open_run(str(path))
    assert again.verdict == result.verdict
    assert again.summary == json.loads(json.dumps(result.summary))
    assert again.outcome.steps == result.outcome.steps
    assert np.array_equal(again.record.time, result.record.time)
    for name, values in result.errors.items():
        assert np.array_equal(again.errors[name], values)
    copied = again.save(tmp_path / "copy")
    assert (copied / "summary.json").read_bytes() == (path / "summary.json").read_bytes()
    assert result.differences(ff.open_run(copied)) == []


@pytest.mark.parametrize("kind", ["missing", "empty", "file", "incomplete", "running", "other"])
def test_what_is_no_finished_run_is_not_opened(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "run"
    if kind == "incomplete":
        incomplete(path)
    elif kind == "running":
        RunDirectory.claim(path)
    elif kind == "file":
        path.write_text("")
    elif kind != "missing":
        path.mkdir()
    if kind == "other":
        (path / "notes.txt").write_text("")
    expected = {
        "missing": "it does not exist", "empty": "it has no summary.json", "file": "Not a directory",
        "incomplete": "`freeflyer recover` completes it", "running": "still writes it", "other": "it has no summary.json",
    }  # fmt: skip
    with pytest.raises(RecordError, match=expected[kind]):
        ff.open_run(path)
    if kind != "file":
        with pytest.raises(CosimError):
            ff.run(path)


def test_runs_are_listed_filtered_and_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "freeflyer_out"
    for period in (0.1, 0.2):
        ff.run(SCENARIO, {"stop_s": 0.5, "base_controller.period": period}).save()
    ff.run("multirate_unstable", {"stop_s": 0.1}).save()
    incomplete(folder / "dead")
    (folder / "notes").mkdir()
    found = ff.runs()
    assert len(found) == 4
    assert [run.started for run in found] == sorted((run.started for run in found), reverse=True)
    assert found[0].state == "incomplete"
    assert {run.name for run in ff.runs(scenario="multirate_unstable")} == {"multirate_unstable"}
    assert [run.directory for run in ff.runs(end="incomplete")] == [Path("freeflyer_out/dead")]
    (one,) = ff.runs(where={"base_controller.period": 0.1})
    assert one.parameters["base_controller.period"] == 0.1
    (two,) = ff.runs(where={"base_controller.period": 0.2})
    text = output(capsys, "runs")
    assert all(str(run.directory) in text for run in found)
    listed = json.loads(output(capsys, "runs", "--json", "--where", "base_controller.period=0.1"))
    assert [item["directory"] for item in listed] == [str(one.directory)]
    text = output(capsys, "runs", "--compare", one.directory, two.directory)
    assert "base_controller.period" in text
    assert "free_flyer.base_mass" not in text
    compared = json.loads(output(capsys, "runs", "--compare", "--json", one.directory, two.directory))  # fmt: skip
    assert [item["parameters"]["base_controller.period"] for item in compared] == [0.1, 0.2]
    with pytest.raises(RecordError, match="at least two are needed"):
        ff.runs(one.directory).compare()
    with pytest.raises(RecordError, match="there is no folder"):
        ff.runs(tmp_path / "nowhere")


def test_a_sweep_does_not_write_to_the_directory_of_a_run(tmp_path: Path) -> None:
    out = tmp_path / "out"
    ff.run(SCENARIO, SHORT, directory=out)
    before = names(out)
    plan = {"scenario": SCENARIO, "grid": {"base_controller.period": [0.1]}}
    with pytest.raises(CosimError, match="is the directory of a run"):
        ff.sweep(plan, {"stop_s": 12}, directory=out)
    assert names(out) == before


def test_a_run_does_not_write_to_the_directory_of_a_sweep(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "sweep.json").write_text("{}")
    with pytest.raises(OutputError, match="other files than a run"):
        ff.run(SCENARIO, SHORT, directory=out)
    assert names(out) == {"sweep.json"}


def test_settings_that_differ_are_named(tmp_path: Path) -> None:
    one = ff.run(SCENARIO, {"stop_s": 0.3})
    other = ff.run(SCENARIO, {"stop_s": 0.3, "exchange": "parallel", "record.every_s": 0.02})
    found = one.differences(other)
    assert "setting exchange: 'sequential' and 'parallel'" in " ".join(found) or (
        "setting exchange: missing and 'parallel'" in found
    )
    assert "setting record.every_s: 0.01 and 0.02" in found
    one.save(tmp_path / "one")
    other.save(tmp_path / "other")
    rows = {
        row[0]: row[1:] for row in ff.runs([tmp_path / "one", tmp_path / "other"]).compare().rows
    }
    assert rows["record.every_s"] == ("0.01", "0.02")


def test_a_change_that_a_later_one_overrides_is_not_listed(tmp_path: Path) -> None:
    ff.run(SCENARIO, {"stop_s": 0.1, "base_controller.period": 0.2}, directory=tmp_path / "one")
    again = ff.run(tmp_path / "one", {"base_controller.period": 0.25})
    assert again.scenario.changes == ("stop_s=0.1", "base_controller.period=0.25")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"folder": None}, "the folder of runs is None"),
        ({"where": {1: 0.3}}, "where is {1: 0.3}"),
        ({"where": "a.b=1"}, "where is 'a.b=1'"),
        ({"where": {"base_controler.period": 0.3}}, "did you mean 'base_controller.period'"),
        ({"scenario": "multirate_pasive"}, "did you mean 'multirate_passive'"),
        ({"folder": "missing"}, "there is no folder missing"),
    ],
)
def test_a_mistake_in_a_filter_is_one_sentence(
    arguments: dict[str, Any], expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ff.run("multirate_passive", {"stop_s": 0.01}, directory="one")
    with pytest.raises(CosimError, match=re.escape(expected)):
        ff.runs(**{"folder": ".", **arguments})
