"""The battery: its cases, its verdicts, and its table."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.analysis.sweep.designs import NamedDesigns
from freeflyer.analysis.sweep.plan import Plan
from freeflyer.paper import battery, battery_cases


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


def test_the_table_counts_stable_and_convergent_runs() -> None:
    rows = [
        row("robust", "push", True, 1.0),
        row("robust", "noise", True, 0.0),
        row("robust", "drawn 001", True, 1.0),
        row("robust", "drawn 002", False, None),
        row("ceiling", "push", False, 1.0),
        row("ceiling", "drawn 001", True, 1.0),
        row("ceiling", "drawn 002", True, 1.0),
    ]
    assert battery.counted(rows, "robust") == ["2 of 2", "1 of 2", "1 of 2", "1 of 2", "1 of 2"]
    assert battery.not_convergent(rows) == [
        "`robust`: noise (stable); drawn 002 (not stable)",
        "`ceiling`: push (not stable)",
    ]


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
