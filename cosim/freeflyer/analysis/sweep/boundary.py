"""Predicted stability boundary for a sweep's map: the largest stable period for each value of y."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from freeflyer.analysis.prediction.boundary import predict
from freeflyer.analysis.prediction.set_point import at_set_point
from freeflyer.analysis.sweep.file import Map
from freeflyer.analysis.sweep.plan import Plan
from freeflyer.fmi.component import Array
from freeflyer.foundation.errors import CosimError, ScenarioError
from freeflyer.foundation.signal_name import component_of, split
from freeflyer.foundation.units import converted, factor


def check(plan: Plan) -> None:
    """Check, before any run, that the boundary of the plan's map can be predicted.

    Raises ScenarioError if x is not a controller's period or if a case cannot be linearised.
    """
    figure = plan.sweep.map
    if figure is None or not figure.predict:
        return
    component, parameter = split(figure.x)
    if parameter != "period":
        raise ScenarioError(
            f"sweep {plan.sweep.path}: [map] predict: x is {figure.x}; a controller's period (COMPONENT.period) is expected"
        )
    for case in plan.sweep.cases:
        try:
            with at_set_point(
                plan.setup.scenario(case, _assignments(plan, figure, case, None)), component
            ):
                pass
        except CosimError as error:
            raise ScenarioError(
                f"sweep {plan.sweep.path}: [map] predict, case {case}: {error}"
            ) from error


def predicted(
    plan: Plan, figure: Map, done: Callable[[str | None], None]
) -> Mapping[str, tuple[Array, Array]]:
    """Return the boundary of each case: periods x and values y, in the units of the map's axes.

    x is NaN if the loop is stable up to the map's edge or if the point cannot be predicted.
    `done` is called after each point, with a message if the prediction failed and None otherwise.
    """
    component = component_of(figure.x)
    lines = {}
    for case in plan.sweep.cases:
        longest = _longest(plan, figure, case)
        unit = longest / max(plan.levels(figure.x))  # [s] of the axis's unit, or of a factor of 1
        ys, xs = np.array(plan.levels(figure.y), dtype=float), []
        for y in ys:
            scenario = plan.setup.scenario(case, _assignments(plan, figure, case, float(y)))
            found, failed = longest, None
            try:
                found = predict(
                    scenario, longest=longest, component=component, beyond=False
                ).largest_stable_s
            except CosimError as error:
                failed = f"no boundary for case {case} at {figure.y} = {y:g}: {error}"
            xs.append(found / unit if found < longest else np.nan)
            done(failed)
        lines[case] = (np.array(xs), ys)
    return lines


def points(plan: Plan, figure: Map) -> int:
    """Return the number of points that `predicted` computes, which is how often it calls `done`."""
    return len(plan.sweep.cases) * len(plan.levels(figure.y))


def _longest(plan: Plan, figure: Map, case: str) -> float:
    """Return the longest period of the map [s]; the axis may be in another unit, or a factor."""
    value = dict(_assignments(plan, figure, case, None))[figure.x]
    if isinstance(value, dict):
        return converted(value["value"], factor(value["unit"], "s"))
    return float(np.ravel(value)[0])


def _assignments(
    plan: Plan, figure: Map, case: str, y: float | None
) -> tuple[tuple[str, Any], ...]:
    """Return assignments with the longest period, `y`, and the first value of every other axis."""
    chosen: dict[str, Any] = {figure.x: max(plan.levels(figure.x))}
    if y is not None:
        chosen[figure.y] = y
    return plan.assignments(
        case, tuple(chosen.get(str(axis.target), plan.first_of(axis)) for axis in plan.axes)
    )
