"""Metrics of a run: errors, observed energies, and the content of summary.json."""

from __future__ import annotations

import functools
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from freeflyer.fmi.component import Array, Component
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.signal_name import split
from freeflyer.master.graph import port
from freeflyer.master.master import Outcome
from freeflyer.master.record import Record
from freeflyer.scenario.scenario import Scenario

LAST = 10.0
"""Length [s] of the last part of a run. summary.json has the maximum of each error in this part."""


def position_error(actual: Array, desired: Array) -> Array:
    """Return the Euclidean distances (rows,) [m] between positions (rows, 3) [m]."""
    return np.asarray(np.linalg.norm(actual - desired, axis=1))


def orientation_error(actual: Array, desired: Array) -> Array:
    """Return the angles (rows,) [deg] between quaternions [x, y, z, w] (rows, 4)."""
    actual = actual / np.linalg.norm(actual, axis=1, keepdims=True)
    desired = desired / np.linalg.norm(desired, axis=1, keepdims=True)
    # The angle is computed from the distance between the two quaternions. The scalar product of
    # the quaternions is not used: at a small angle it is rounded to 1, and the angle is lost.
    # q and -q are the same orientation. The sign of `desired` is chosen such that the two
    # quaternions are closer to each other. This gives the smaller one of the two possible angles.
    nearer = desired * np.where(np.sum(actual * desired, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    return np.asarray(np.degrees(4.0 * np.arcsin(0.5 * np.linalg.norm(actual - nearer, axis=1))))


ERRORS = {"position": position_error, "orientation": orientation_error}


def signal_or_parameter(signal: str, record: Record) -> Array:
    """Return the values (rows, size) of a signal in a record.

    The signal is a recorded output, or a parameter in the provenance of the record. The value of a
    parameter is the same in all rows. Raises RecordError if the record has neither.
    """
    component, parameter = split(signal)
    parameters = record.provenance.parameters.get(component, {}) if record.provenance else {}
    if signal in record or parameter not in parameters:
        return np.atleast_2d(record[signal].T).T
    value = np.atleast_1d(np.asarray(parameters[parameter], dtype=float))
    return np.broadcast_to(value, (record.rows, value.size))


def check(scenario: Scenario, components: Mapping[str, Component]) -> None:
    """Check before the run that all signals of the metrics exist and have the right size.

    Raises CosimError.
    """
    for name, measure in scenario.errors.items():
        actual, desired = (
            port(components, signal, f"errors.{name}")
            for signal in (measure.actual, measure.desired)
        )
        size = 3 if measure.kind == "position" else 4
        for signal, found in ((measure.actual, actual), (measure.desired, desired)):
            if found.size != size:
                raise ScenarioError(
                    f"errors.{name}: {signal} has {found.size} elements; {size} are expected"
                )
            if not found.real or not (found.causality == "output" or found.start is not None):
                raise ScenarioError(f"errors.{name}: {signal} is neither an output nor a parameter")
    for name, signal in scenario.observed_energy.items():
        if port(components, signal, f"observed_energy.{name}").causality != "output":
            raise ScenarioError(f"observed_energy.{name}: {signal} is not an output")


def errors(scenario: Scenario, record: Record) -> dict[str, Array]:
    """Return the time series (rows,) of each error. The keys are the names in summary.json."""
    series = {}
    for name, measure in scenario.errors.items():
        actual, desired = (
            signal_or_parameter(signal, record) for signal in (measure.actual, measure.desired)
        )
        series[f"{name}_error_{measure.unit}"] = ERRORS[measure.kind](actual, desired)
    return series


def summary(scenario: Scenario, outcome: Outcome, series: Mapping[str, Array]) -> dict[str, Any]:
    """Return the content of summary.json.

    `series` is the result of `errors`.
    Maxima and minima ignore values that are not finite, because JSON cannot represent such values.
    """
    time = outcome.record.time
    last = time >= outcome.simulated - LAST
    energies = {}
    for name, signal in scenario.observed_energy.items():
        energies[name] = {"min": finite_minimum(outcome.record[signal])}
    return {
        "scenario": scenario.name,
        "diverged": outcome.diverged,
        "cause": outcome.cause,
        "diverged_at_s": outcome.simulated if outcome.diverged else None,
        "failed": outcome.failed,
        "interrupted": outcome.interrupted,
        "simulated_s": outcome.simulated,
        "wall_s": outcome.wall,
        "steps": outcome.steps,
        **{
            name: {"max": finite_maximum(values), "last_10_s": finite_maximum(values[last])}
            for name, values in series.items()
        },
        "observed_energy_j": energies,
        "versions": dict(versions()),
    }


def finite_maximum(values: Array) -> float | None:
    """Return the largest finite value, or None if no value is finite."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if finite.size else None


def finite_minimum(values: Array) -> float | None:
    """Return the smallest finite value, or None if no value is finite."""
    highest = finite_maximum(-values)
    return None if highest is None else -highest


@functools.cache
def versions() -> Mapping[str, str]:
    """Return the versions of Python, the platform and the packages that affect the results."""
    found = {"python": platform.python_version(), "platform": platform.platform(terse=True)}
    for package in ("freeflyer-cosim", "fmpy", "casadi", "numpy", "scipy", "ziglang"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found
