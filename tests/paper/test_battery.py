"""The battery: its cases, its verdicts, its table and its figure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import colors
from matplotlib import pyplot as plt

from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.analysis.sweep.designs import NamedDesigns
from freeflyer.analysis.sweep.plan import Plan
from freeflyer.paper import battery, battery_cases, battery_figure


def designs() -> dict[str, Any]:
    found = sweep_file.read("battery").designs
    assert isinstance(found, NamedDesigns)
    return dict(found.settings)


def test_the_file_has_the_71_named_cases_and_the_100_drawn_cases() -> None:
    named = [name for name in designs() if not name.startswith("drawn ")]
    assert len(named) == 71
    drawn = {name: value for name, value in designs().items() if name.startswith("drawn ")}
    assert drawn == battery_cases.drawn()
    assert len(drawn) == 100


def test_a_strategy_is_not_changed_by_a_case() -> None:
    plan = Plan(sweep_file.read("battery"))
    runs = [plan.run(number) for number in range(len(plan))]
    assert len(runs) == 6 * 171
    ceiling = [run for run in runs if run.case == "ceiling"]
    assert not any(
        target == "base_controller.period" for run in ceiling for target, _ in run.assignments
    )
    robust = [run for run in runs if run.case == "robust"]
    assert any(
        target == "base_controller.period" for run in robust for target, _ in run.assignments
    )


def row(case: str, name: str, stable: bool, within: float | None) -> dict[str, Any]:
    return {"case": case, "design_name": name, "stable": stable, "within_limits": within}


ROWS = [
    row("robust", "push", True, 1.0),
    row("robust", "noise", True, 0.0),
    row("robust", "drawn 001", True, 1.0),
    row("robust", "drawn 002", False, None),
    row("ceiling", "push", False, 1.0),
    row("ceiling", "drawn 001", True, 1.0),
    row("ceiling", "drawn 002", True, 1.0),
]


def test_the_table_counts_stable_and_convergent_runs() -> None:
    assert battery.counted(ROWS, "robust") == ["2 of 2", "1 of 2", "1 of 2", "1 of 2", "1 of 2"]
    assert battery.not_convergent(ROWS) == [
        "`robust`: noise (stable); drawn 002 (not stable)",
        "`ceiling`: push (not stable)",
    ]


def test_the_report_writes_the_table_and_the_figure(tmp_path: Path) -> None:
    battery.evaluation.report(ROWS, ["design_name"], tmp_path)
    assert (tmp_path / battery.FILE).read_text().startswith("| strategy |")
    height, width, _ = plt.imread(tmp_path / battery.FIGURE).shape
    assert width == 2000
    assert height > 900


def test_the_figure_has_a_row_of_coloured_cells_for_each_strategy() -> None:
    rows = [
        row("robust", "joint 1", True, 1.0),
        row("robust", "noise x1", True, 0.0),
        row("robust", "drawn 001", False, None),
        row("robust", "drawn 002", True, 1.0),
        row("robust_without_pc", "joint 1", False, 0.0),
        row("robust_without_pc", "noise x1", True, 1.0),
        row("robust_without_pc", "drawn 001", False, 0.0),
        row("robust_without_pc", "drawn 002", True, 0.0),
    ]
    both = [battery.verdicts(rows, drawn=drawn) for drawn in (False, True)]
    figure = battery_figure.draw(*both)
    expected = [
        [["convergent", "stable only"], ["not stable", "convergent"]],
        [["convergent", "not stable"], ["stable only", "not stable"]],  # the easiest case first
    ]
    for panel, verdicts in zip(figure.axes, expected, strict=True):
        strategies = [label.get_text() for label in panel.get_yticklabels()]
        assert strategies == ["robust", "robust without PC"]
        for cells, own in zip(panel.collections, verdicts, strict=True):
            shown = [colors.to_hex(colour).upper() for colour in cells.get_facecolor()]
            assert shown == [battery_figure.COLOURS[verdict] for verdict in own]
    names = [[label.get_text() for label in panel.get_xticklabels()] for panel in figure.axes]
    assert names == [["joint 1", "noise x1"], ["002", "001"]]
    texts = {text.get_text() for text in figure.axes[0].texts}
    assert {"push on a joint", "noise", "1 of 2"} <= texts
    plt.close(figure)


def test_each_named_case_has_a_kind_of_disturbance() -> None:
    kinds = {name: battery_figure.kind(name) for name in designs() if not name.startswith("drawn ")}
    assert set(kinds.values()) == set(battery_figure.KINDS)
    assert kinds["joint 2 2 Nm every 20 s"] == "repeated push"
    assert kinds["base Ty 5 Nm"] == "push on the base"


@pytest.mark.parametrize("kind", battery_cases.RANGES)
def test_each_kind_of_disturbance_is_drawn_within_its_range(kind: str) -> None:
    random = np.random.default_rng(5)
    for _ in range(50):
        settings = getattr(battery_cases.Draw(random), kind.replace(" ", "_"))()
        assert settings
        for target, value in settings.items():
            if target.endswith("pulse_joint_torque"):
                (size,) = (abs(number) for number in value if number)
                assert 0.5 <= size <= 10.0
            if target.endswith("_factor"):
                assert 0.7 <= value <= 1.3
            if target == "base_controller.period":
                assert 0.05 <= value <= 1.0
            if target.endswith("translation_amplitude"):
                assert np.abs(value).max() <= 0.2
