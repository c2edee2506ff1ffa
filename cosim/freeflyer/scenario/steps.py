"""Communication steps of a scenario's components, from the key `step_s` of each component."""

from __future__ import annotations

from collections.abc import Mapping

from freeflyer.fmi.component import Array, Component
from freeflyer.foundation.clock import nanoseconds
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.scenario.parameters import Values
from freeflyer.scenario.scenario import ComponentSpec, Scenario


def communication_steps(
    scenario: Scenario, components: Mapping[str, Component], values: Values
) -> dict[str, int]:
    """Return the communication step [ns] of each component.

    If `step_s` is "=PARAMETER", the step is the value of this parameter of the component. `values`
    has the values that the scenario sets. For other parameters the start value is used.
    Raises ScenarioError if the component does not have this parameter.
    """
    return {
        spec.name: _step(spec, components[spec.name], values[spec.name])
        for spec in scenario.components
    }


def _step(spec: ComponentSpec, component: Component, values: Mapping[str, Array]) -> int:
    if isinstance(spec.step, int):
        return spec.step
    name = spec.step[1:]
    port = component.ports.get(name)
    if port is None or (name not in values and port.start is None):
        raise ScenarioError(
            f"component {spec.name}: step_s = {spec.step!r}: there is no parameter {name!r}{did_you_mean(name, component.ports)}"
        )
    value = values[name][0] if name in values else (port.start or (0.0,))[0]
    return nanoseconds(float(value), f"component {spec.name}: parameter {name}")
