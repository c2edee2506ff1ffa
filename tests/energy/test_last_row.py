"""The last row of a record: no step begins at the stop time (docs/scenarios.md)."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest

import freeflyer as ff
from freeflyer.analysis.audit import energy
from freeflyer.master.provenance import Provenance
from freeflyer.scenario.experiment import Engine

SLOW_ARM = {
    "manipulator_controller.period": 0.002,
    "manipulator_controller.damping": [20.0] * 3 + [1.0] * 3,
}
RUNS: dict[str, dict[str, Any]] = {
    "a sample of both controllers": {"stop_s": 12.0},
    "a sample of the manipulator controller": {"stop_s": 12.1},
    "a sample of neither": {**SLOW_ARM, "stop_s": 6.001},
    "between two rows": {"stop_s": 12.004},
    "between two rows, a sample of neither": {**SLOW_ARM, "stop_s": 6.003},
    "a limit": {"limits": True},
}


@cache
def recorded(end: str, every: float = 0.01) -> ff.Result:
    changes = {**RUNS[end], "record.every_s": every}
    if changes.pop("limits", False):
        return ff.run("overdamped_base", changes)
    return ff.run("multirate_unstable", changes)


@pytest.mark.parametrize("end", RUNS)
@pytest.mark.parametrize("every", [0.01, 0.002])
def test_summary_and_audit_have_the_same_least_observed_energy(end: str, every: float) -> None:
    run = recorded(end, every)
    ports = ff.audit(run).summary["ports"]
    for port, name in (("B", "base"), ("M", "manipulator")):
        least = run.summary["observed_energy_j"][name]["min"]
        assert ports[port]["observer"]["least_j"] == least


@pytest.mark.parametrize("end", RUNS)
def test_observed_and_true_energy_of_the_last_row_are_those_of_the_last_sample(end: str) -> None:
    """Each has changed since the sample before. With another rule, the last gap is as large."""
    audit = ff.audit(recorded(end, 0.001))
    for port in (audit.base, audit.manipulator):
        gaps = np.abs(port.observed - port.absorbed).max(axis=1)
        assert gaps[-1] <= 1.1 * gaps[:-1].max()
    assert audit.summary["ports"]["B"]["observer"]["sum_at_end_j"] == audit.base.observed[-1].sum()


@pytest.mark.parametrize("engine", ["core", "python"])
@pytest.mark.parametrize(
    ("changes", "sampled"),
    [({"stop_s": 0.3}, False), ({"free_flyer.base_velocity": [0.0] * 5 + [1.1]}, True)],
    ids=["stop time", "limit"],
)
def test_the_controllers_hold_their_last_samples_at_the_stop_time(
    changes: dict[str, Any], sampled: bool, engine: Engine
) -> None:
    moving = {"free_flyer.base_velocity": [0.0] * 5 + [0.1]}
    run = ff.run(
        "multirate_unstable", {**moving, **changes, "record.every_s": 0.001}, engine=engine
    )
    assert run.record.provenance is not None
    assert run.record.provenance.sampled_at_end == sampled
    if not sampled:
        for signal in ("manipulator_controller.joint_torque", "base_controller.base_wrench"):
            assert np.array_equal(run.record[signal][-1], run.record[signal][-2])
        for signal in ("free_flyer.base_position", "reference_trajectory.position"):
            assert not np.array_equal(run.record[signal][-1], run.record[signal][-2])
        assert run.outcome.steps == {
            "free_flyer": 300,
            "reference_trajectory": 300,
            "manipulator_controller": 300,
            "base_controller": 1,
        }


def test_the_provenance_of_an_earlier_record_is_that_of_a_completed_run() -> None:
    provenance = recorded("a limit").record.provenance
    assert provenance is not None
    assert Provenance.from_json(provenance.to_json()) == provenance
    earlier = json.loads(provenance.to_json())
    assert earlier.pop("sampled_at_end")
    assert not Provenance.from_json(json.dumps(earlier)).sampled_at_end
    with pytest.raises(ValueError, match="the type bool is expected"):
        Provenance.from_json(json.dumps({**earlier, "sampled_at_end": 1}))


def test_the_mean_of_held_samples_on_a_line_is_exact_in_every_interval() -> None:
    """Five samples per interval, and none at the end."""
    samples = np.arange(20.0)[:, None]
    rows = np.append(samples[::5], samples[-1:], axis=0)
    means = samples.reshape(4, 5, 1).mean(axis=1)
    assert energy.held(rows, 0.2, sampled_at_end=False) == pytest.approx(means)
