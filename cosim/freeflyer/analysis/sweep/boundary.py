"""The predicted boundary on top of a sweep's map: for each value of y the largest period that the linear loop is stable up to."""

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


def check(plan: Plan) -> None:
    """ScenarioError, before anything runs, for a map whose x is no period, or a loop that cannot be predicted."""
    figure = plan.sweep.map
    if figure is None or not figure.predict:
        return
    component, parameter = split(figure.x)
    if parameter != "period":
        raise ScenarioError(
            f"sweep {plan.sweep.path}: [map] predict: x is {figure.x}; the period of a controller is expected, COMPONENT.period"
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
    """Points (x, y) by case; x is not finite where the loop stays stable up to the map's edge, and where it cannot be predicted (a
    value that an FMU refuses is a failed row there). `done` is called after each point, with a sentence if it cannot be predicted.
    """
    component = component_of(figure.x)
    longest = max(plan.levels(figure.x))
    lines = {}
    for case in plan.sweep.cases:
        ys, xs = np.array(plan.levels(figure.y), dtype=float), []
        for y in ys:
            scenario = plan.setup.scenario(case, _assignments(plan, figure, case, float(y)))
            found, refused = longest, None
            try:
                found = predict(
                    scenario, longest=longest, component=component, beyond=False
                ).largest_stable_s
            except CosimError as error:
                refused = f"no boundary for case {case} at {figure.y} = {y:g}: {error}"
            xs.append(found if found < longest else np.nan)
            done(refused)
        lines[case] = (np.array(xs), ys)
    return lines


def points(plan: Plan, figure: Map) -> int:
    """How often `predicted` calls `done`."""
    return len(plan.sweep.cases) * len(plan.levels(figure.y))


def _assignments(
    plan: Plan, figure: Map, case: str, y: float | None
) -> tuple[tuple[str, Any], ...]:
    """At the longest period, at `y`, and at the first value of whatever else varies."""
    chosen: dict[str, Any] = {figure.x: max(plan.levels(figure.x))}
    if y is not None:
        chosen[figure.y] = y
    return plan.assignments(
        case, tuple(chosen.get(str(axis.target), plan.first_of(axis)) for axis in plan.axes)
    )
