"""Notes of a run about wrong premises of its observers."""

from __future__ import annotations

import pytest

import freeflyer as ff
from freeflyer.analysis import observer_notes

CASES = {
    "manipulator_controller.base_law_damping": ([1.0] * 6, "base_law_damping is [1.0, "),
    "manipulator_controller.position_setpoint": ([0.1, 0.0, 0.0], "position_setpoint is [0.1, "),
    "manipulator_controller.manipulator_initial_energy": (
        0.05,
        "needs no initial energy, but manipulator_initial_energy is [0.05, ",
    ),
}


@pytest.mark.parametrize("target", CASES)
def test_a_wrong_premise_of_the_observer_reference_is_a_note(target: str) -> None:
    value, expected = CASES[target]
    run = ff.run("robust", {"stop_s": 0.01, target: value})
    (note,) = observer_notes.notes(run.record.provenance)
    assert expected in note


@pytest.mark.parametrize("name", ["robust", "disturbed", "facility_robust"])
def test_the_shipped_scenarios_have_no_note(name: str) -> None:
    run = ff.run(name, {"stop_s": 0.01})
    assert observer_notes.notes(run.record.provenance) == []
