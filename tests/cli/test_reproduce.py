"""The command `freeflyer reproduce`: its files, and the keys of summary.json."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path
from typing import Any

import pytest
from matplotlib import pyplot

from freeflyer.cli import main as command
from freeflyer.foundation.interrupts import interrupts
from freeflyer.paper import reproduce
from freeflyer.scenario import experiment, scenario
from freeflyer.scenario.experiment import Result
from freeflyer.scenario.scenario import Scenario

ERRORS = {
    "end_effector_position_error_m",
    "end_effector_orientation_error_deg",
    "base_position_error_m",
    "base_orientation_error_deg",
}
KEYS = {
    "scenario",
    "diverged",
    "cause",
    "diverged_at_s",
    "simulated_s",
    "wall_s",
    "steps",
    "observed_energy_j",
    "versions",
} | ERRORS


def test_an_interrupted_reproduce_keeps_the_completed_cases(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    load, run = scenario.load, experiment.run

    def interrupted_in_the_second(case: Scenario, **options: Any) -> Result:
        with interrupts():
            if case.name == "multirate_unstable":
                signal.raise_signal(signal.SIGINT)
            return run(case, **options)

    monkeypatch.setattr(scenario, "load", lambda name: load(name, ["stop_s=0.5"]))
    monkeypatch.setattr(experiment, "run", interrupted_in_the_second)
    assert command.call(["reproduce", "--out", str(tmp_path)]) == 3
    shown = " ".join(capsys.readouterr().out.split())
    assert "Interrupted; the cases continuous, multirate_unstable are saved in" in shown
    cases = json.loads((tmp_path / "summary.json").read_text())["cases"]
    assert {name: case["interrupted"] for name, case in cases.items()} == {
        "continuous": False,
        "multirate_unstable": True,
    }
    assert all(case.keys() >= KEYS for case in cases.values())
    assert {path.name for path in tmp_path.iterdir()} == {
        "continuous",
        "multirate_unstable",
        "summary.json",
    }
    assert (tmp_path / "continuous" / "record.parquet").is_file()


def test_reproduce_of_the_first_21_seconds_writes_figures_page_and_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The pictures are small here; the slow test checks them in full size."""
    load = scenario.load

    def small(figure: Any, path: Path) -> None:
        figure.savefig(path, dpi=30)
        pyplot.close(figure)

    monkeypatch.setattr(scenario, "load", lambda name: load(name, ["stop_s=21"]))
    monkeypatch.setattr(reproduce, "save", small)
    assert command.call(["reproduce", "--out", str(tmp_path)]) == 3  # divergence needs more time
    shown = " ".join(capsys.readouterr().out.split())
    assert "The paper's statements and the measured results" in shown
    assert "Not as expected: multirate_unstable, paper_unstable" in shown
    assert len(list(tmp_path.glob("fig*.png"))) == 12
    assert (tmp_path / "report.html").read_text().count("data:image/png;base64,") == 15


@pytest.mark.slow
def test_reproduce_writes_figures_page_table_and_summary(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.call(["reproduce", "--fmi", "3", "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "The paper's statements and the measured results" in shown.out
    for number in ("02", "03", "04", "07", "08", "09", "10", "11", "12", "13", "14"):
        assert (tmp_path / f"fig{number}.png").stat().st_size > 20_000
        assert (tmp_path / f"fig{number}.pdf").is_file()
    cases = json.loads((tmp_path / "summary.json").read_text())["cases"]
    assert list(cases) == [
        "continuous",
        "multirate_unstable",
        "multirate_passive",
        "overdamped_base",
        "facility",
        "facility_without_pc",
        "paper_continuous",
        "paper_unstable",
        "paper_passive",
        "sustained_continuous",
        "sustained_unstable",
        "sustained_passive",
        "sustained_mixed_continuous",
        "sustained_mixed_unstable",
        "sustained_mixed_passive",
    ]
    for name in ("multirate_unstable", "multirate_passive"):
        assert (tmp_path / f"energy_audit_{name}.png").stat().st_size > 20_000
    for name, case in cases.items():
        assert case.keys() >= KEYS
        assert case["scenario"] == name
        assert all(set(case[error]) == {"max", "last_10_s"} for error in ERRORS)
        assert set(case["observed_energy_j"]) == {"manipulator", "base"}
        assert (tmp_path / name / "record.parquet").is_file()
    assert [cases[name]["diverged"] for name in cases] == [
        *(False, True, False, True, False, False),
        *(False, True, False) * 3,
    ]
    # Every statement on Figs. 3 to 10 holds with the first set, and with the two other sets.
    rows = re.findall(r"│ (Fig\. \d+) .*│ (as stated|in part|differs) +│\n", shown.out)
    expected = ["Fig. 3", "Fig. 4", "Fig. 7", "Fig. 8", "Fig. 9", "Fig. 10", "Fig. 11", "Fig. 12"]
    assert rows == [(figure, "as stated") for figure in expected]
    assert shown.out.count(": 6 as stated") == 2
    page = (tmp_path / "report.html").read_text()
    # Self-contained: the page contains all pictures and loads nothing.
    assert page.count("data:image/png;base64,") == 15
    assert not re.search(r"(src|href)=\"(?!data:)", page)
    assert "http" not in re.sub(r"base64,[^\"]*", "", page)
