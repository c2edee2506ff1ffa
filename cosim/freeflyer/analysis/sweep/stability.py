"""Verdict on a run: the rule by which a sweep calls a run stable.

A finite run cannot show convergence. It can only show whether the errors still grow. A run is
stable if the errors in its last 10 s are not larger than before. The first 10 s are left out.
The shipped references have a period of 10 s. They reach their full amplitude within 5 s. Therefore
the window at the end contains one whole period of the reference. The window at the start contains
the transient of the start.
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
"""Allowed ratio of the maximum error in the last window to the maximum before it."""
FLOORS = {"m": 3e-3, "deg": 0.1}
"""The growth of an error is ignored if the error is below this value [m, deg].

3 mm is a quarter of the residual base error in the paper, 12 mm. 0.1 deg is about a tenth of the
smallest orientation error in the paper, 1.1 deg.
"""
EARLIER = "earlier"
LAST = f"last_{WINDOW:g}_s"


def criterion() -> dict[str, Any]:
    """Return the constants of the rule. They are part of the plan's content."""
    return {"window_s": WINDOW, "growth": GROWTH, "floors": FLOORS}


def earlier(time: Array, error: Array, end: float) -> float | None:
    """Return the maximum of an error (n) between the first and the last window.

    `time` (n) and `end` are in s. The result is None if no value is finite.
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
