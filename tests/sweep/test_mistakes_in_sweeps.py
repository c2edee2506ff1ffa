"""Errors in sweep files and options: one-line message, exit code 2, no run is started."""

from __future__ import annotations

import os
import socket
import subprocess
import threading
from pathlib import Path

import pytest
from commands import run_command
from families import family
from hypothesis import given
from hypothesis import strategies as st
from marked_sweeps import MarkedSweep, until
from schedulers import scheduler, worker

from freeflyer.analysis.sweep import cluster, stability

P = '"base_controller.period"'


def error_of(capsys: pytest.CaptureFixture[str], directory: Path, text: str, *options: str) -> str:
    """Return the error message for a sweep file `text`; a missing key `scenario` is added."""
    file = directory / "mine.toml"
    file.write_text(
        text
        if "scenario =" in text
        else f'scenario = "multirate_passive"\nset = ["stop_s=1"]\n{text}'
    )
    code, error = run_command(capsys, "sweep", str(file), "--out", str(directory / "out"), *options)
    assert code == 2, error
    assert not (directory / "out" / "parts").exists()
    return error


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            f"[grid]\n{P} = []",
            "[grid] base_controller.period is []; a list with at least one value",
        ),
        (
            "[grid]",
            "varies no parameter; a [grid], a [sample], a [vary] with parameters, or [designs.NAME] is expected",
        ),
        ("", "varies no parameter"),
        ('[grid]\n"base_controller.perod" = [0.1]', "no parameter 'perod'; did you mean 'period'"),
        (
            '[grid]\n"base_controler.period" = [0.1]',
            "no component 'base_controler'; did you mean 'base_controller'",
        ),
        (
            '[grid]\n"base_controller.stifness[1:3]" = [1]',
            "there is no parameter 'base_controller.stifness'; did you mean 'stiffness'",
        ),
        (
            '[grid]\n"robot.base_mas" = [1]',
            "no component has a parameter 'base_mas'; did you mean 'base_mass'",
        ),
        (
            f"[grid]\n{P} = [0.1, 0.0025, 0.2]",
            "step of 0.0025 s is not a multiple of the smallest step, 0.001 s",
        ),
        (f"[grid]\n{P} = {{ first = 0.1, last = 0.2, count = 4 }}", "whole number of nanoseconds"),
        (
            f"[grid]\n{P} = {{ first = 0.1, last = 0.2, count = 0 }}",
            "count is 0; at least 2 values",
        ),
        (
            f"[grid]\n{P} = {{ first = 0.2, last = 0.1, count = 3 }}",
            "from 0.2 to 0.1; two finite numbers, the lower one first",
        ),
        (
            f"[grid]\n{P} = {{ first = 0, last = 1, count = 3, logarithmic = true }}",
            "starts at 0.0; a number above zero",
        ),
        (
            f"[grid]\n{P} = {{ first = 0.2, last = 0.3, count = 3, multiple_of = 0.4 }}",
            "no multiple of 0.4 from 0.2 to 0.3",
        ),
        (
            f"[grid]\n{P} = {{ first = 0.2, last = 0.3, count = 3, multiple = 0.1 }}",
            "unknown key 'multiple'",
        ),
        (
            f"[grid]\n{P} = {{ first = 0.2, last = 0.3, count = 3, unit = 'kg' }}",
            "unit 'kg' cannot be converted to 's'",
        ),
        (
            '[grid]\n"base_controller.stiffness" = [[1, 2]]',
            "base_controller.stiffness has 2 values; 6 are expected",
        ),
        (
            '[grid]\n"base_controller.stiffness[5:7]" = [1]',
            "base_controller.stiffness[5:7]: base_controller.stiffness has 6 elements",
        ),
        (
            '[grid]\n"base_controller.stiffness[3:1]" = [1]',
            "elements are counted from 1, and the first must not exceed the last",
        ),
        ('[grid]\n"manipulator_controller.observer" = ["prot"]', "did you mean 'port'"),
        (
            '[grid]\n"manipulator_controller.observer[1]" = [1]',
            "is not a real parameter; a sweep cannot vary its elements",
        ),
        (
            '[grid]\n"base_controller.stiffness[1:3]" = [1]\n"base_controller.stiffness[3]" = [1]',
            "is varied twice, also as",
        ),
        (
            f"[cases.a]\n{P} = 0.2\n[grid]\n{P} = [0.1]",
            "[cases.a] sets base_controller.period, but the axis",
        ),
        (
            '[cases.a]\n"base_controller.perid" = 0.2\n[grid]\n"stop_s" = [1]',
            "case a: component 'base_controller' has no parameter 'perid'",
        ),
        (
            f"[sample]\ncount = 0\n[sample.parameters]\n{P} = {{ low = 0.1, high = 0.2 }}",
            "[sample] count is 0; a whole number from 1",
        ),
        (
            f"[sample]\ncount = 3\nmethod = 'latin'\n[sample.parameters]\n{P} = [1]",
            "one of latin_hypercube, random is expected",
        ),
        ("[sample]\ncount = 3", "[sample] has no parameters"),
        (
            f"[sample]\ncount = 3\n[sample.parameters]\n{P} = {{ low = 0.1 }}",
            "high is missing; a number is expected",
        ),
        (
            f"[grid]\n{P} = [0.1]\n[map]\nx = {P}\ny = 'base_controller.damping'",
            "[map] y is 'base_controller.damping'; a target of the grid",
        ),
        (
            f"[grid]\n{P} = [0.1, 0.2]\n[map]\nx = {P}\ny = {P}",
            "[map] x and y are both base_controller.period",
        ),
        ("scenario = 'multirate_pasive'\n[grid]\nstop_s = [1]", "no scenario 'multirate_pasive'"),
        ("[grid]\n'facility.seed' = [1, 2]", "facility.seed has no effect on the results"),
        (
            "[grid]\n'record.signals' = ['a']",
            "record.signals has no effect on the results",
        ),
        (
            "scenario = 3",
            "scenario is 3; a shipped scenario or a .toml file beside the sweep is expected",
        ),
        ("[grid", "is not valid TOML"),
        ("[gird]\nstop_s = [1]", "unknown key 'gird' in the sweep; did you mean 'grid'"),
        (
            "set = ['nonsense']\nscenario = 'multirate_passive'\n[grid]\nstop_s = [1]",
            "--set nonsense: COMPONENT.PARAMETER=VALUE",
        ),
    ],
)
def test_errors_in_files_are_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, message: str
) -> None:
    assert message in error_of(capsys, tmp_path, text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("stability_mop",),
            "no sweep 'stability_mop': neither a shipped one nor a .toml file; did you mean 'stability_map'",
        ),
        (("missing.toml",), "sweep file missing.toml does not exist"),
        (("stability_map", "--workers", "0"), "at least one worker is expected"),
        (
            ("stability_map", "--workers", "100000"),
            f"because this machine has {os.cpu_count()} cores",
        ),
        (
            ("stability_map", "--workers", "2", "--scheduler", "tcp://127.0.0.1:1"),
            "give either --workers or --scheduler",
        ),
        (
            ("stability_map", "--set", "base_controller.perod=1"),
            "no parameter 'perod'; did you mean 'period'",
        ),
    ],
)
def test_errors_in_options_are_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    code, error = run_command(capsys, "sweep", *arguments, "--out", str(tmp_path / "out"))
    assert code == 2
    assert message in error
    assert not (tmp_path / "out" / "parts").exists()


def test_a_directory_with_another_sweep_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    sweep = MarkedSweep(tmp_path, count=1)
    assert sweep.run(capsys)[0] == 0
    sweep.file.write_text(sweep.file.read_text().replace("[1]", "[2]"))
    code, _, error = sweep.run(capsys)
    assert code == 2
    assert (
        "has results of another sweep ('sweep'; designs differ); choose another --out, or remove this directory"
        in error
    )
    sweep.file.write_text(sweep.file.read_text().replace("[2]", "[1]"))
    code, _, error = sweep.run(capsys, "--set", "one.nap=0.1")
    assert code == 2
    assert "scenario differ" in error
    (sweep.out / "sweep.json").write_text("[]")
    code, _, error = sweep.run(capsys)
    assert code == 2
    assert "is not a plan of a sweep" in error
    assert sweep.times_run(2) == 0


def test_a_file_as_output_directory_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    code, error = run_command(capsys, "sweep", "stability_map", "--out", str(tmp_path / "file"))
    assert code == 2
    assert "cannot be written" in error


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:{port}", "127.0.0.1:{port}", "nonsense", "ftp://127.0.0.1:{port}"]
)
def test_an_unreachable_scheduler_is_an_error(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    address: str,
) -> None:
    monkeypatch.setattr("freeflyer.analysis.sweep.cluster.ANSWER", 1.0)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))  # no process listens on this port
        where = address.format(port=free.getsockname()[1])
        refused = MarkedSweep(tmp_path, count=2)
        code, _, error = refused.run(capsys, "--scheduler", where)
    assert code == 2
    assert not refused.out.exists()
    assert f"the scheduler {where} does not answer" in error
    assert len(error.strip().splitlines()) == 1, error


def test_a_scheduler_without_workers_is_an_error(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("freeflyer.analysis.sweep.cluster.ANSWER", 2.0)
    with scheduler(tmp_path) as (address, _):
        code, _, error = MarkedSweep(tmp_path, count=2).run(capsys, "--scheduler", address)
    assert code == 2
    assert (
        f"the scheduler {address} has no workers; start one with `dask worker {address}`" in error
    )


OTHER_PYTHON = """
import sys, distributed.versions
original = distributed.versions.get_package_info
distributed.versions.get_package_info = lambda names: original(names) | {"python": "2.7.18.final.0"}
"""


@pytest.mark.parametrize("other", family(["package", "python"]))
def test_a_worker_with_another_version_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, other: str
) -> None:
    sweep = MarkedSweep(tmp_path, count=2)
    about = tmp_path / "older" / "freeflyer_cosim-0.1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: freeflyer-cosim\nVersion: 0.1.0\n"
    )
    before, path = (OTHER_PYTHON, None) if other == "python" else ("", about.parent)
    with scheduler(tmp_path) as (address, _), worker(address, tmp_path, before=before, path=path):
        code, _, error = sweep.run(capsys, "--scheduler", address)
    assert code == 2, error
    has = (
        "python 2.7, but python 3."
        if other == "python"
        else "freeflyer-cosim 0.1.0, but freeflyer-cosim"
    )
    assert f"has {has}" in error
    assert "install the same version on the worker" in error
    assert sweep.times_run(1) == sweep.times_run(2) == 0


def test_an_external_scheduler_computes_the_sweep(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep = MarkedSweep(tmp_path, count=6)
    monkeypatch.setenv("MARKS", str(sweep.marks))
    with scheduler(tmp_path) as (address, _), worker(address, tmp_path) as process:
        code, _, error = sweep.run(capsys, "--scheduler", address)
        assert (code, error) == (0, "")
        assert process.poll() is None  # the command does not stop an external worker
    assert [sweep.times_run(x) for x in range(1, 7)] == [1] * 6


@pytest.mark.slow
def test_a_killed_scheduler_stops_the_sweep_and_finished_runs_are_kept(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep = MarkedSweep(tmp_path, count=200, nap=0.1)
    monkeypatch.setitem(cluster.CONFIGURATION, "distributed.comm.timeouts.connect", "1s")
    monkeypatch.setenv("MARKS", str(sweep.marks))

    def kill_after_the_first_part(process: subprocess.Popen[bytes]) -> None:
        until(lambda: bool(sweep.parts), process)
        process.kill()

    with scheduler(tmp_path) as (address, process), worker(address, tmp_path):
        killer = threading.Thread(target=kill_after_the_first_part, args=(process,))
        killer.start()
        code, _, error = sweep.run(capsys, "--scheduler", address)
        killer.join()
    assert code == 3
    assert "the scheduler does not answer any more; finished runs are kept" in error
    assert sweep.parts


errors = st.floats(0.0, 1e3)


@given(last=errors, before=errors, unit=st.sampled_from(["m", "deg"]))
def test_decreasing_errors_are_stable_and_errors_that_grow_above_the_floor_are_unstable(
    last: float, before: float, unit: str
) -> None:
    summary = {
        "diverged": False,
        "failed": False,
        "simulated_s": 60.0,
        f"x_error_{unit}": {"last_10_s": last},
    }
    found = stability.stable(summary, {f"x_error_{unit}": before})
    if last <= before or last <= stability.FLOORS[unit]:
        assert found is True
    if last > stability.FLOORS[unit] and last > 1.06 * before:
        assert found is False
    assert stability.stable(summary | {"diverged": True}, {f"x_error_{unit}": before}) is False
    assert stability.stable(summary | {"simulated_s": 19.0}, {f"x_error_{unit}": before}) is None


def test_a_varied_parameter_cannot_be_set_by_an_option(capsys: pytest.CaptureFixture[str]) -> None:
    code, error = run_command(capsys, "sweep", "stability_map", "--set", "base_controller.period=1")
    assert code == 2
    assert "base_controller.period is varied by the sweep" in error
