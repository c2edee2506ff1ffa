"""Longer repetition of the runs of a sweep whose errors still grew at their end.

Usage: python tests/benchmarks/growing_designs.py SWEEP DIR CASE...

SWEEP is a shipped sweep or a file; DIR contains its results. For each run of the cases that is
neither stable nor diverged, prints the verdict after five times the duration. Prints, too, the
natural frequency of the base relative to that of the trajectory (0.1 Hz).
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas

from freeflyer.analysis.sweep import file, stability
from freeflyer.analysis.sweep.plan import Plan
from freeflyer.scenario import experiment

LONGER = 5
BASE_INERTIA = np.array([156.0, 161.0, 161.0, 45.0, 22.0, 23.0])
"""Diagonal of M~ at the start posture [kg, kg m2]."""
REFERENCE = 2.0 * np.pi * 0.1
"""Angular frequency of the trajectory [rad/s]."""


def main(sweep: str, directory: str, *cases: str) -> None:
    # The runs without a verdict of stable, diverged or failed.
    plan = Plan(file.read(sweep))
    table = pandas.read_parquet(Path(directory) / "results.parquet")
    growing = table[
        table["case"].isin(cases)
        & table["stable"].eq(False)
        & ~table["diverged"]
        & ~table["failed"]
    ]
    settled = dict.fromkeys(cases, 0)
    for number in growing["run"]:
        # The same run, longer.
        run = plan.run(int(number))
        scenario = plan.setup.scenario(run.case, run.assignments)
        scenario = replace(
            scenario,
            stop=LONGER * scenario.stop,
            record_every=10 * scenario.record_every,
            record_signals=(),
        )
        result = experiment.run(scenario)
        record = result.outcome.record
        before = {
            name: stability.earlier(record.time, error, result.outcome.simulated)
            for name, error in result.errors.items()
        }
        stable = stability.stable(result.summary, before)
        settled[run.case] += stable is True
        # The natural frequency that is nearest to the trajectory's.
        given = dict(run.assignments)
        stiffness = np.array(given["base_controller.stiffness"], dtype=float)
        resonance = np.sqrt(stiffness / BASE_INERTIA) / REFERENCE
        nearest = resonance[np.argmin(np.abs(np.log(resonance)))]
        largest = max(result.summary["base_orientation_error_deg"]["last_10_s"], 0.0)
        print(
            f"run {number}, {run.case}: {'stable' if stable else 'NOT stable'} after {result.outcome.simulated:g} s; nearest natural "
            f"frequency of the base / the trajectory's: {nearest:.2f}; base {1e3 * result.summary['base_position_error_m']['last_10_s']:.1f} mm, "
            f"{largest:.2f} deg",
            flush=True,
        )
    for case in cases:
        count = int(growing["case"].eq(case).sum())
        print(
            f"{case}: {settled[case]} of {count} runs with growing errors are stable in the longer run"
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
