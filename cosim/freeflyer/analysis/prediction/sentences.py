"""Sentences that describe a prediction."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from freeflyer.analysis.prediction.modes import LARGEST

if TYPE_CHECKING:
    from freeflyer.analysis.prediction.boundary import Scan
    from freeflyer.analysis.prediction.modes import Mode
    from freeflyer.analysis.prediction.trajectory import AlongTrajectory


def milliseconds(time: float) -> str:
    return f"{1e3 * time:.6g} ms"


def of_set_point(prediction: Scan) -> list[str]:
    """Return the sentences about the scan at the set point."""
    lines = [
        f"{prediction.scenario}: period T_b of {prediction.component}, from {milliseconds(prediction.shortest_s)} to "
        f"{milliseconds(prediction.longest_s)}; at the set point, with passivity controllers off"
    ]
    if prediction.shortest_s > prediction.tick_s:
        lines.append(
            f"The controllers accept no period below {milliseconds(prediction.shortest_s)}."
        )
    if prediction.boundary is None:
        lines.append(
            f"Largest stable T_b: {milliseconds(prediction.largest_stable_s)} or more (all scanned periods are stable)"
        )
    elif prediction.largest_stable_s == 0.0:
        lines.append(
            f"Largest stable T_b: none (the loop is unstable even at {milliseconds(prediction.shortest_s)})"
        )
    else:
        lines.append(f"Largest stable T_b: {milliseconds(prediction.largest_stable_s)}")
    beyond = [
        interval for interval in prediction.stable_s if interval[0] > prediction.largest_stable_s
    ]
    for first, last in beyond:
        lines.append(f"Stable again: {milliseconds(first)} to {milliseconds(last)}")
    if prediction.boundary and prediction.limit:
        lines.append(f"Unstable mode: {prediction.boundary.description()}")
        lines.append(f"  at {_grows(prediction.boundary)}")
        lines.append(f"Limited by {prediction.limit.description()}")
    lines.append(f"With T_b of the scenario: at {_grows(prediction.own)}")
    if prediction.neutral:
        lines.append(
            f"{prediction.neutral} neutral modes are left out. A neutral mode neither grows nor decays, because it has no "
            f"restoring force (null space, or no stiffness)."
        )
    return lines


def _grows(mode: Mode) -> str:
    z = mode.multiplier
    rate, form = mode.growth_rate, ".4f" if abs(z) < 1e6 else ".4g"
    value = f"{z.real:{form}}" if z.imag == 0.0 else f"{z.real:{form}} +- {abs(z.imag):{form}} i"
    if rate * mode.period > LARGEST:
        value = f"above {sys.float_info.max:.2g}"
    pace = (
        f"doubles every {0.693147 / rate:.3g} s"
        if rate > 0.0
        else f"halves every {-0.693147 / rate:.3g} s"
        if rate < 0.0
        else "constant"
    )
    return f"{milliseconds(mode.period)} {'unstable' if abs(z) >= 1.0 else 'stable'}: multiplier {value}, {rate:+.3g} 1/s ({pace})"


def of_trajectory(along: AlongTrajectory) -> list[str]:
    """Return the sentences about the analysis along the trajectory."""
    return [
        f"Along the trajectory, from Floquet multipliers (the motion from {along.from_s:g} to {along.to_s:g} s is assumed to be "
        f"periodic):",
        f"  largest stable T_b: {milliseconds(along.largest_stable_s)} (by bisection)",
        f"  at {milliseconds(along.period_s)}: {along.growth_rate:+.3g} 1/s, {'unstable' if along.growth_rate >= 0.0 else 'stable'}",
        f"  frozen-time loop (not a criterion of stability): unstable {100 * along.frozen_unstable:.0f} % of the time; "
        f"its largest growth rate is {along.frozen_growth_rate:+.3g} 1/s (at {along.frozen_at_s:g} s)",
    ]
