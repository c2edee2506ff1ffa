"""Tests of the table [errors]: names and kinds of errors, and invalid tables."""

from __future__ import annotations

from pathlib import Path

import pytest

from freeflyer.foundation.errors import ScenarioError
from freeflyer.scenario import experiment, scenario

SIGNALS = 'actual = "free_flyer.base_orientation", desired = "base_controller.orientation_setpoint"'


def loaded(folder: Path, text: str) -> scenario.Scenario:
    path = folder / "changed.toml"
    path.write_text(f'extends = "multirate_passive"\nstop_s = 0.6\n[errors]\n{text}\n')
    return scenario.load(str(path))


def test_an_error_with_a_declared_kind_has_any_name(tmp_path: Path) -> None:
    chosen = loaded(tmp_path, f'tilt = {{ {SIGNALS}, kind = "orientation" }}')
    found = experiment.run(chosen).summary
    assert found["tilt_error_deg"] == found["base_orientation_error_deg"]
    assert found["tilt_error_deg"]["max"] > 0.0


@pytest.mark.parametrize(
    "text",
    [
        'tilt = ["free_flyer.base_orientation", "base_controller.orientation_setpoint"]',
        f"tilt = {{ {SIGNALS} }}",
        f'tilt = {{ {SIGNALS}, kind = "angle" }}',
        f'tilt = {{ {SIGNALS}, kind = "orientation", unit = "deg" }}',
        'base_position = ["a.b"]',
        'base_position = ["a.b", "c.d", "e.f"]',
        "base_position = 1",
        "base_position = [1, 2]",
    ],
)
def test_invalid_errors_are_rejected(tmp_path: Path, text: str) -> None:
    with pytest.raises(
        ScenarioError, match=r"errors\.\w+: \[actual, desired\] signals are expected"
    ):
        loaded(tmp_path, text)
