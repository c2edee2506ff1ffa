"""Whether a run is called stable: one published rule, because "stable" is what a map of many runs shows.

A run that ends in finite time shows no limit. What it shows is whether errors still grow: whether the last 10 s are worse than
everything since the first 10 s. The shipped references have a period of 10 s and begin within 5 s, so that the last window holds one whole period
of what drives the errors, and the first one what comes of the beginning. docs/sweeps.md says how the constants were found.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from freeflyer.fmi.component import Array
from freeflyer.scenario import metrics

WINDOW = metrics.LAST
"""At the begin of a run, which is left out, and at its end [s]."""
GROWTH = 1.05
"""Errors may be this much larger in the last window than ever before."""
FLOORS = {"m": 3e-3, "deg": 0.1}
"""Smaller errors may grow: a quarter of the paper's residual 12 mm of the base, and a tenth of its smallest 1.1 deg."""
EARLIER = "earlier"
LAST = f"last_{WINDOW:g}_s"


def criterion() -> dict[str, Any]:
    """The rule's constants, to stand beside the results."""
    return {"window_s": WINDOW, "growth": GROWTH, "floors": FLOORS}


def earlier(time: Array, error: Array, end: float) -> float | None:
    """An error's maximum after the first window and before the last; None where nothing is in between."""
    return metrics.finite_maximum(error[(time >= WINDOW) & (time < end - WINDOW)])


def stable(summary: Mapping[str, Any], before: Mapping[str, float | None]) -> bool | None:
    """The verdict on a run by its summary.json and `earlier` of each error; None for a run that is too short to tell."""
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
