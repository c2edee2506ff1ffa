"""The functions of the Python interface: threads, wrong types, and the numbers of the commands."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import freeflyer as ff
import freeflyer_fmus
from freeflyer.cli import main as command


def test_threads_that_run_one_scenario_get_equal_numbers_and_keep_the_working_directory() -> None:
    loop = ff.load("multirate_passive", {"stop_s": 1.0})
    expected = ff.run(loop).record
    before = Path.cwd()
    with ThreadPoolExecutor(6) as pool:
        records = [run.record for run in pool.map(lambda _: ff.run(loop), range(24))]
    assert Path.cwd() == before
    assert all(
        np.array_equal(record[name], expected[name]) for record in records for name in expected
    )


def test_functions_and_commands_write_the_same_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = ["multirate_passive", "--set", "stop_s=2", "--set", "base_controller.period=100 ms"]
    assert command.call(["run", *arguments, "--out", "command"]) == 0
    run = ff.run("multirate_passive", {"stop_s": 2, "base_controller.period": "100 ms"})
    run.save("function")
    one, other = ((Path(k) / "record.parquet").read_bytes() for k in ("command", "function"))
    assert one == other
    timed = ("wall_s", "started", "sha256")
    one, other = (
        {
            key: value
            for key, value in {**summary, **summary["run"]}.items()
            if key not in (*timed, "run")
        }
        for summary in (
            json.loads((Path(k) / "summary.json").read_text()) for k in ("command", "function")
        )
    )
    assert one == other
    assert command.call(["audit", "command"]) == 0
    ff.audit(run).write("function")
    assert (
        command.call(["predict", "multirate_unstable", "--longest", "0.11", "--out", "command"])
        == 0
    )
    ff.predict("multirate_unstable", longest=0.11).write("function")
    for name in ("energy_audit.json", "prediction.json"):
        assert (Path("command") / name).read_bytes() == (Path("function") / name).read_bytes()


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda: ff.load(None), "the scenario is None of type NoneType"),  # type: ignore[arg-type]
        (lambda: ff.run(b"robust"), "the scenario is b'robust' of type bytes"),  # type: ignore[arg-type]
        (lambda: ff.run("robust", engine="c"), "engine is 'c'; 'core' or 'python'"),  # type: ignore[arg-type]
        (lambda: ff.predict(3), "the scenario is 3 of type int"),  # type: ignore[arg-type]
        (lambda: ff.run("robust", progress=3), "progress is 3; a function"),  # type: ignore[arg-type]
        (lambda: ff.predict("robust", longest="1 s"), "longest is '1 s'; a number"),  # type: ignore[arg-type]
        (lambda: ff.describe_fmu("no.fmu"), "no.fmu"),
        (lambda: ff.audit(3), "the record is 3 of type int"),  # type: ignore[arg-type]
        (lambda: ff.sweep(3), "the sweep is 3 of type int"),  # type: ignore[arg-type]
        (lambda: ff.load_ssp(3), "the SSP file is 3 of type int"),  # type: ignore[arg-type]
        (lambda: ff.write_ssp(ff.load("robust"), 3), "the SSP file is 3 of type int"),  # type: ignore[arg-type]
        (lambda: ff.write_ssp("robusd", "a.ssp"), "did you mean 'robust'"),
        (lambda: ff.sweep({"scenario": ff.load("robust")}), "the sweep: scenario is Scenario robust"),
        (lambda: ff.Record.read("missing.parquet"), "missing.parquet cannot be read as a record"),
        (lambda: ff.Record.read(os.devnull), "/dev/null cannot be read as a record"),
    ],
)  # fmt: skip
def test_a_wrong_argument_is_one_sentence(call: Callable[[], object], expected: str) -> None:
    with pytest.raises(ff.CosimError) as caught:
        call()
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_record_iterates_over_the_names_of_its_signals() -> None:
    record = ff.run("multirate_passive", {"stop_s": 0.01}).record
    assert list(record) == list(record.signals)


def test_a_block_file_may_import_its_class_from_the_module_block() -> None:
    from freeflyer_fmus.block import Block

    assert Block is freeflyer_fmus.Block
