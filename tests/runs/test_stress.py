"""Runs, sweeps and audits in one folder, of which some are killed (see stress.py)."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path

import pytest
from stress import SCENARIO, check, round_of

import freeflyer as ff


def test_processes_that_are_killed_leave_whole_or_incomplete_runs(tmp_path: Path) -> None:
    counts, wrong = round_of(tmp_path, 8, 4, 2, kinds=("run", "replaced"))
    assert wrong == []
    assert counts["finished"] >= 3


@pytest.mark.slow
def test_many_processes_that_are_killed_leave_whole_or_incomplete_runs(tmp_path: Path) -> None:
    counts, wrong = round_of(tmp_path, seed=2, processes=14, kills=7)
    assert wrong == []
    assert counts["killed"] > 0


def test_the_check_finds_mixed_and_undocumented_results(tmp_path: Path) -> None:
    for name, stop in {"shared": 0.1, "replaced": 0.2}.items():
        ff.run(SCENARIO, {"stop_s": stop}, directory=tmp_path / name)
    assert list(check(tmp_path, Counter())) == []
    (tmp_path / "shared" / "notes.txt").write_text("")
    (tmp_path / "undocumented").mkdir()
    shutil.copy(tmp_path / "shared" / "record.parquet", tmp_path / "replaced")
    wrong = " ".join(check(tmp_path, Counter()))
    for text in ("notes.txt", "undocumented is not documented", "is not the record that the run"):
        assert text in wrong
