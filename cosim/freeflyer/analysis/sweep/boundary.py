"""Predict the stability boundary for the map of a sweep.

The x axis of the map is the period of a controller. A point of the boundary is the largest stable
period for one value on the y axis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from freeflyer.analysis.prediction.predict import predict
from freeflyer.analysis.prediction.set_point import at_set_point
from freeflyer.analysis.sweep.file import Map
from freeflyer.analysis.sweep.plan import Plan
from freeflyer.fmi.component import Array
from freeflyer.foundation.errors import CosimError, ScenarioError
from freeflyer.foundation.signal_name import component_of, split
from freeflyer.foundation.units import converted, factor


def check(plan: Plan) -> None:
    """Check before the first run that the boundary for the map of the plan can be predicted.

    Raises ScenarioError if x is not the period of a controller, or if a case cannot be linearised.
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

    x is NaN if the loop is stable up to the longest period of the map. x is also NaN if the
    prediction of the point failed. `done` is called after each point. Its argument is None, or a
    message if the prediction failed.
    """
    component = component_of(figure.x)
    lines = {}
    for case in plan.sweep.cases:
        longest = _longest(plan, figure, case)
        # `unit` [s] is the unit of the x axis. If the x values are factors, `unit` is the period
        # for the factor 1.
        unit = longest / max(plan.levels(figure.x))
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
    """Return the number of points for which `predicted` calls `done`."""
    return len(plan.sweep.cases) * len(plan.levels(figure.y))


def _longest(plan: Plan, figure: Map, case: str) -> float:
    """Return the longest period [s] of the map.

    The values on the x axis can have another unit, or they can be factors. Therefore the value is
    converted to s.
    """
    value = dict(_assignments(plan, figure, case, None))[figure.x]
    if isinstance(value, dict):
        return converted(value["value"], factor(value["unit"], "s"))
    return float(np.ravel(value)[0])


def _assignments(
    plan: Plan, figure: Map, case: str, y: float | None
) -> tuple[tuple[str, Any], ...]:
    """Return the assignments for the longest period on the x axis and the value `y` on the y axis.

    Every other axis has its first value. If `y` is None, the y axis also has its first value.
    """
    chosen: dict[str, Any] = {figure.x: max(plan.levels(figure.x))}
    if y is not None:
        chosen[figure.y] = y
    return plan.assignments(
        case, tuple(chosen.get(str(axis.target), plan.first_of(axis)) for axis in plan.axes)
    )
