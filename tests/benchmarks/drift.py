"""Drift of energy and momenta of the free robot: python tests/benchmarks/drift.py [FMU]

Prints the largest relative drift over a fixed time, for joint speeds, seeds and integration steps,
and the exponent of the drift in the step. No input acts. The start is that of
tests/laws/test_conservation.py, with all velocities multiplied.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "laws"))
from test_conservation import drift

from freeflyer_fmus.export.prebuilt import directory

SEEDS = (7, 1, 2, 3, 4)


def main() -> None:
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else directory() / "fmi2" / "free_flyer.fmu"

    def worst(seed: int, speed: float, duration: float, step: float) -> float:
        found = drift(
            path, round(duration / 1e-3), 500, seed=seed, speed=speed, integration_step=step
        )
        return max(found.values())

    print("largest drift over 100 s at integration steps of 1, 1/3, 1/7, 1/10 ms")
    for speed in (0.1, 1.0):
        for seed in SEEDS:
            steps = (1e-3, 1e-3 / 3.0, 1e-3 / 7.0, 1e-4)
            values = [worst(seed, speed / 0.1, 100.0, step) for step in steps]
            print(f"{speed:4g} rad/s rms, seed {seed}:", ", ".join(f"{v:.1e}" for v in values))
    print("exponent of the drift in the step: 1 rad/s rms, 100 s, 1 to 8 ms")
    for seed in SEEDS:
        steps = np.array([1e-3, 2e-3, 4e-3, 8e-3])
        drifts = [
            drift(
                path, round(100.0 / h), round(0.5 / h),
                seed=seed, speed=10.0, integration_step=h, communication_step=h,
            )
            for h in steps
        ]  # fmt: skip
        exponents = {
            name: np.polyfit(np.log(steps), np.log([found[name] for found in drifts]), 1)[0]
            for name in drifts[0]
        }
        print(f"seed {seed}:", ", ".join(f"{name} {e:.2f}" for name, e in exponents.items()))


if __name__ == "__main__":
    main()
