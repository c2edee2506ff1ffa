"""Killed workers and sweeps: finished runs are kept and are not repeated."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pandas
import psutil
import pytest
from marked_sweeps import PATIENCE, MarkedSweep, kill_9, until, workers_of


def test_no_run_is_lost_when_a_worker_is_killed(tmp_path: Path) -> None:
    sweep = MarkedSweep(tmp_path, count=24, nap=0.15)
    process = sweep.start()
    until(lambda: len(sweep.parts) >= 3, process)
    killed = workers_of(process)[0]
    kill_9(killed)
    _, error = process.communicate(timeout=PATIENCE)
    assert (process.returncode, error) == (0, "")
    assert list(sweep.results["one.x"]) == list(range(1, 25))
    assert not sweep.results["failed"].any()
    assert all(sweep.times_run(x) >= 1 for x in range(1, 25))
    assert str(killed.pid) in "".join(path.read_text() for path in sweep.marks.iterdir())


@pytest.mark.slow
def test_a_killed_sweep_resumes_without_repeating_finished_runs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    sweep = MarkedSweep(tmp_path, count=60, nap=0.1)
    process = sweep.start()
    until(lambda: len(sweep.parts) >= 4, process)
    workers = workers_of(process)
    kill_9(psutil.Process(process.pid))
    process.communicate(timeout=PATIENCE)
    before = sweep.parts
    finished = {
        int(x)
        for path in (sweep.out / "parts").glob("*.parquet")
        for x in pandas.read_parquet(path)["one.x"]
    }
    assert 0 < len(finished) < 60
    psutil.wait_procs(workers, timeout=PATIENCE)  # workers exit without a scheduler
    assert not any(worker.is_running() for worker in workers)
    code, output, error = sweep.run(capsys, "--workers", "2")
    assert (code, error) == (0, "")
    assert f"{len(finished)} of 60 runs are in" in output
    assert list(sweep.results["one.x"]) == list(range(1, 61))
    assert {name: sweep.parts[name] for name in before} == before
    assert all(sweep.times_run(x) == 1 for x in finished)


@pytest.mark.slow
def test_ctrl_c_keeps_finished_runs_and_prints_how_to_resume(tmp_path: Path) -> None:
    sweep = MarkedSweep(tmp_path, count=60, nap=0.2)
    process = sweep.start()
    until(lambda: len(sweep.parts) >= 3, process)
    os.killpg(process.pid, signal.SIGINT)  # like a terminal, also to the workers
    _, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == 3
    assert len(error.strip().splitlines()) == 1, error
    assert "of 60 runs; the same command computes the remaining runs" in error
    finished = sum(
        len(pandas.read_parquet(path)) for path in (sweep.out / "parts").glob("*.parquet")
    )
    assert f"interrupted after {finished} of 60 runs" in error
    assert not (sweep.out / "results.parquet").exists()


@pytest.mark.slow
def test_a_run_that_kills_its_worker_becomes_a_failed_row_and_the_sweep_finishes(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    sweep = MarkedSweep(tmp_path, count=8, deadly=5)
    code, output, error = sweep.run(capsys)
    assert (code, error) == (0, "")
    failed = sweep.results[sweep.results["failed"]]
    assert list(failed["one.x"]) == [5]
    assert "its worker died in each of 3 attempts" in failed["cause"].iloc[0]
    assert "its worker died in each of 3 attempts" in output


@pytest.mark.slow
def test_two_sweeps_cannot_use_one_directory(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    sweep = MarkedSweep(tmp_path, count=300, nap=0.2)
    process = sweep.start()
    try:
        until(lambda: len(sweep.parts) >= 1, process)
        code, _, error = sweep.run(capsys)
        assert code == 2
        assert "another sweep is running in" in error
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.communicate(timeout=PATIENCE)
    assert process.returncode == 3


@pytest.mark.slow
def test_a_damaged_part_is_computed_again(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    sweep = MarkedSweep(tmp_path, count=4)
    assert sweep.run(capsys)[0] == 0
    damaged = min((sweep.out / "parts").iterdir())
    lost = pandas.read_parquet(damaged)["one.x"]
    damaged.write_bytes(damaged.read_bytes()[:100])
    code, output, _ = sweep.run(capsys)
    assert code == 0
    assert f"{4 - len(lost)} of 4 runs are in" in output
    assert list(sweep.results["one.x"]) == [1, 2, 3, 4]
    assert [sweep.times_run(x) for x in range(1, 5)] == [
        2 if x in list(lost) else 1 for x in range(1, 5)
    ]
