"""Simulated growth of a small perturbation along a motion: the difference of two runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation
from simulated_period import QUIET, STATES, Array, starting_at

from freeflyer.analysis.prediction.task_coordinates import TaskCoordinates
from freeflyer.master.record import Record
from freeflyer.scenario import scenario
from freeflyer.scenario.assemble import assembled

OFF = QUIET[:2]
"""Overrides: no passivity controllers; the reference moves."""


def _run(name: str, overrides: Sequence[str], start: Array) -> Record:
    with assembled(scenario.load(name, [*OFF, *overrides, *starting_at(start)])) as (master, _):
        outcome = master.run()
    assert not outcome.cause, outcome.cause
    return outcome.record


def growth_rate(
    name: str, overrides: Sequence[str], coordinates: TaskCoordinates, starts: int = 1
) -> float:
    """Return the growth rate [1/s] of a perturbation of 1e-6 at the start.

    It is the slope of ln sqrt(energy) over the second half. The energy is the sum over `starts`
    random perturbations.
    """
    period = next(
        text.partition("=")[2] for text in overrides if text.startswith("base_controller.period")
    )
    overrides = [*overrides, f"record.every_s={period}"]
    random, total = np.random.default_rng(1), 0.0
    reference = _run(name, overrides, np.zeros(24))
    for _ in range(starts):
        start = random.normal(size=24)
        other = _run(name, overrides, 1e-6 * start / np.linalg.norm(start))
        parts = [other[f"free_flyer.{s}"] - reference[f"free_flyer.{s}"] for s in STATES]
        orientations = [
            Rotation.from_quat(record["free_flyer.base_orientation"])
            for record in (other, reference)
        ]
        parts[1] = (orientations[0] * orientations[1].inv()).as_rotvec()
        total = total + coordinates.energy(np.hstack(parts).T).sum(axis=0)
    time = reference.time
    late = time >= 0.5 * time[-1]
    return float(np.polyfit(time[late], 0.5 * np.log(total[late]), 1)[0])
