"""Resolve the parameters of a scenario: check values, convert units, follow references."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from freeflyer.fmi.component import Array, Component, Port
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.signal_name import split
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.toml_file import as_written
from freeflyer.foundation.units import DIMENSIONLESS, converted, factor, is_quantity, quantity, same
from freeflyer.scenario.scenario import Scenario

Values = dict[str, dict[str, Array]]
_FINITE = "finite numbers are expected"


def resolve(scenario: Scenario, components: Mapping[str, Component]) -> Values:
    """Return the values [SI] that the scenario sets, by component and variable.

    A value of [robot] applies to all components that have a parameter of this name. A value that is
    set for one component overrides the value of [robot].
    Raises ScenarioError if a name, a unit or an enumeration value is unknown. Also raises
    ScenarioError if a size is wrong or a value is not finite.
    """
    # All raw values are collected first, because a value can be a reference to a parameter of any
    # other component.
    raw: dict[str, dict[str, Any]] = {}
    used: set[str] = set()
    for spec in scenario.components:
        ports = components[spec.name].ports
        common = {
            name: value
            for name, value in scenario.robot.items()
            if name in ports and ports[name].settable
        }
        used |= set(common)
        raw[spec.name] = {**common, **spec.parameters}

    # An unused key of [robot] is probably misspelled. Therefore such a key is an error.
    for name in scenario.robot:
        if name not in used:
            every = {
                parameter
                for component in components.values()
                for parameter, port in component.ports.items()
                if port.settable
            }
            raise ScenarioError(
                f"[robot]: no component has a parameter {name!r}{did_you_mean(name, every)}"
            )

    return {
        spec.name: {
            name: _value(raw, components, spec.name, name, value, ())
            for name, value in raw[spec.name].items()
        }
        for spec in scenario.components
    }


def current(
    components: Mapping[str, Component], values: Values, component: str, parameter: str
) -> Array:
    """Return the value [SI] of a parameter.

    If `values` does not contain the parameter, the start value of its port is returned.
    """
    if parameter in values.get(component, {}):
        return values[component][parameter]
    start = components[component].ports[parameter].start
    return np.array(start if start is not None else [0.0])


def _value(
    raw: Mapping[str, Mapping[str, Any]],
    components: Mapping[str, Component],
    component: str,
    name: str,
    value: Any,
    seen: tuple[str, ...],
) -> Array:
    """Return the value of the variable `name` of `component` as an array (port.size,) [SI].

    `value` is this value as in the scenario file. It can be a reference to another value. Therefore
    `raw` contains all values of the scenario. `seen` contains the references that were followed so
    far.
    """
    # `component` and `name` can come from a reference in the scenario file. Therefore they may not
    # exist.
    subject = f"{component}.{name}"
    if component not in components:
        raise ScenarioError(
            f"{seen[-1]} = '={subject}': there is no component {component!r}{did_you_mean(component, components)}; set another value of {seen[-1]}"
        )
    ports = components[component].ports
    if name not in ports:
        raise ScenarioError(
            f"component {component!r} has no parameter {name!r}{did_you_mean(name, [n for n, p in ports.items() if p.settable])}"
            "; to leave out the parameters of an extended scenario, set inherited_parameters = false"
        )

    # Inputs can be set, too. `assemble` rejects the value if a connection drives the input.
    port = ports[name]
    if not port.settable and port.causality != "input":
        raise ScenarioError(f"{subject} cannot be set: it is a computed {port.causality}")

    # A reference "=COMPONENT.PARAMETER" gives the value of this parameter. If the scenario does not
    # set this parameter, the reference gives the start value of the parameter.
    if isinstance(value, str) and value.startswith("="):
        if subject in seen:
            raise ScenarioError(
                f"{subject}: its value refers to itself through {' -> '.join(seen)}"
            )
        other, parameter = split(value[1:])
        if not (other and parameter):
            raise ScenarioError(f"{subject} is {value!r}; '=COMPONENT.PARAMETER' is expected")
        given = raw.get(other, {}).get(parameter)
        if given is None and other in components and parameter in components[other].ports:
            start = components[other].ports[parameter].start
            given = list(start) if start is not None else None
        result = _sized(
            _value(raw, components, other, parameter, given, (*seen, subject)), port, subject
        )
        for theirs, ours in zip(components[other].ports[parameter].units, port.units, strict=False):
            if not same(theirs, ours):
                raise ScenarioError(f"{subject} = {value!r}: units differ: {ours} and {theirs}")
        return result
    return _sized(_numbers(value, port, subject), port, subject)


def _numbers(value: Any, port: Port, subject: str) -> Array:
    given, scale = value, np.ones(port.size)
    if isinstance(value, str) and port.real:
        value = quantity(value) or value  # "300 ms"
    if isinstance(value, dict) and port.choices:
        value = _combined(value, port, subject)
    if isinstance(value, dict) and value.keys() == {"first"}:
        return _first(value["first"], port, subject)
    if isinstance(value, dict) and port.boolean:
        raise ScenarioError(f"{subject} is {as_written(value)}; {_expected(port)}")
    if isinstance(value, dict):
        if not is_quantity(value):
            raise ScenarioError(
                f"{subject} is {as_written(value)}; {{ value = ..., unit = ... }} is expected"
            )
        scale = np.array([_factor(value["unit"], unit, subject) for unit in port.units])
        value = value["value"]
    if isinstance(value, str):
        if value not in port.choices:
            raise ScenarioError(
                f"{subject} is {as_written(value)}; {_expected(port)}{did_you_mean(value, port.choices) if port.choices else ''}"
            )
        return np.array([float(port.choices.index(value) + 1)])
    items = value if isinstance(value, list) else [value]
    for item in items:
        if isinstance(item, bool) != port.boolean or not isinstance(item, bool | int | float):
            raise ScenarioError(f"{subject} is {as_written(value)}; {_expected(port)}")
        if not abs(item) <= 1e300:
            raise ScenarioError(f"{subject} is {as_written(value)}; {_FINITE}")
    numbers = np.array([float(item) for item in items])
    if port.choices and not all(
        1 <= number <= len(port.choices) and number == int(number) for number in numbers
    ):
        raise ScenarioError(f"{subject} is {as_written(value)}; {_expected(port)}")
    scales = scale if numbers.size == scale.size else np.full(numbers.size, scale[0])
    found = np.array([converted(number, by) for number, by in zip(numbers, scales, strict=True)])
    if not np.all(np.isfinite(found)):
        raise ScenarioError(f"{subject} is {as_written(given)}; {_FINITE}")
    return found


def _combined(value: dict[str, Any], port: Port, subject: str) -> str:
    """Return the name of the enumeration value that a table of its parts describes.

    The table { manipulator = "applied", base = "as_printed" } describes the value
    "manipulator_applied_base_as_printed". If both parts were "applied", it describes "applied".
    """
    names = {str(name) for name in value.values()}
    for order in itertools.permutations(value) if 2 <= len(value) <= 3 else ():
        pattern = "_".join(rf"{re.escape(key)}_\w+" for key in order)
        if not any(re.fullmatch(pattern, choice) for choice in port.choices):
            continue
        name = names.pop() if len(names) == 1 else "_".join(f"{k}_{value[k]}" for k in order)
        if name in port.choices:
            return name
        break
    raise ScenarioError(
        f"{subject} is {as_written(value)}; {_expected(port)}, or a table of the parts of such a name"
    )


def _first(value: Any, port: Port, subject: str) -> Array:
    """Return the start values of the port, with the first elements replaced by `value`."""
    if not isinstance(value, list) or not 1 <= len(value) <= port.size or port.start is None:
        found = f"{len(value)} values" if isinstance(value, list) else as_written(value)
        raise ScenarioError(
            f"{subject} has {found} in 'first'; a list of 1 to {port.size} values is expected"
        )
    start = np.array(port.start, dtype=float)
    start[: len(value)] = _numbers(value, port, subject)
    return start


def _factor(unit: object, target: str | None, subject: str) -> float:
    try:
        return factor(str(unit), target or DIMENSIONLESS)
    except ValueError as error:
        raise ScenarioError(
            f"{subject}: {error}; {target or 'a number without unit'} is expected"
        ) from error


def _sized(numbers: Array, port: Port, subject: str) -> Array:
    if numbers.size == port.size:
        return numbers
    if numbers.size == 1:
        return np.full(port.size, numbers[0])
    raise ScenarioError(f"{subject} has {numbers.size} values; {port.size} are expected")


def _expected(port: Port) -> str:
    """Return the last part of an error message: the value that the port expects."""
    if port.choices:
        return "one of " + ", ".join(port.choices) + " is expected"
    if port.boolean:
        return "true or false is expected"
    unit = f" in {port.units[0]}" if port.units and port.units[0] else ""
    return (
        f"a number{unit} is expected"
        if port.size == 1
        else f"{port.size} numbers{unit} are expected"
    )
