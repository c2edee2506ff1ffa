"""Verdict on a run: the rule by which a sweep calls a run stable.

A finite run cannot show convergence. It can only show whether the errors still grow. A run that
diverged or failed is not stable. For any other run, the maximum of each error in the last 10 s (the
last window) is compared with the maximum before. The first 10 s (the first window) are left out of
this comparison. The run is stable if no error has grown. GROWTH and FLOORS define the tolerance.
The desired motions of the shipped scenarios have a period of 10 s. They reach their full amplitude
within 5 s. Therefore the last window contains one whole period of the motion, and the first window
contains the transient of the start.
docs/sweeps.md explains the choice of the constants.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from freeflyer.fmi.component import Array
from freeflyer.scenario import metrics

WINDOW = metrics.LAST
"""Length of the windows at the start and at the end of a run [s]."""
GROWTH = 1.05
"""Largest ratio that does not count as growth: maximum in the last window / maximum before it."""
FLOORS = {"m": 3e-3, "deg": 0.1}
"""Growth is ignored if the error in the last window does not exceed this value. Keys are units.

The residual base error in the paper is 12 mm; 3 mm is a quarter of it. The smallest orientation
error in the paper is 1.1 deg; 0.1 deg is about a tenth of it.
"""
EARLIER = "earlier"
LAST = f"last_{WINDOW:g}_s"


def criterion() -> dict[str, Any]:
    """Return the constants of the rule. They are a part of `Plan.content`."""
    return {"window_s": WINDOW, "growth": GROWTH, "floors": FLOORS}


def earlier(time: Array, error: Array, end: float) -> float | None:
    """Return the maximum of an error between the first and the last window.

    `error` (n) has the values at the times `time` (n) [s]. `end` [s] is the end of the run. The
    result is None if no value is finite.
    """
    return metrics.finite_maximum(error[(time >= WINDOW) & (time < end - WINDOW)])


def stable(summary: Mapping[str, Any], before: Mapping[str, float | None]) -> bool | None:
    """Return the verdict on a run, or None if the run is too short.

    `summary` is the content of summary.json. `before` contains the result of `earlier` for each
    error.
    """
    if summary["diverged"] or summary["failed"]:
        return False
    if summary["simulated_s"] < 3.0 * WINDOW:
        return None
    return all(
        _bounded(summary[name][LAST], most, FLOORS[name.rpartition("_")[2]])
        for name, most in before.items()
    )


def _bounded(last: float | None, before: float | None, floor: float) -> bool:
    return last is not None and before is not None and last <= max(GROWTH * before, floor)
