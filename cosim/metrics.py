"""What a run amounts to: errors, observed energies, and summary.json."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from cosim.component import Array, Component
from cosim.errors import ScenarioError
from cosim.graph import port, split
from cosim.master import Outcome
from cosim.parameters import Values, current
from cosim.record import Record
from cosim.scenario import Scenario

LAST = 10.0
"""Errors are also given as the maximum over the last 10 s of a run."""


def position_error(actual: Array, desired: Array) -> Array:
    """Euclidean distance (rows) [m]."""
    return np.asarray(np.linalg.norm(actual - desired, axis=1))


def orientation_error(actual: Array, desired: Array) -> Array:
    """Angle (rows) [deg] between quaternions [x, y, z, w]."""
    product = np.abs(np.sum(actual * desired, axis=1)) / np.linalg.norm(actual, axis=1) / np.linalg.norm(desired, axis=1)
    # Near zero the vector part is exact where the scalar part has lost all digits.
    signed = desired * np.sign(np.sum(actual * desired, axis=1, keepdims=True) + 1e-300)
    half_chord = 0.5 * np.linalg.norm(actual / np.linalg.norm(actual, axis=1, keepdims=True) - signed, axis=1)
    return np.asarray(
        np.degrees(
            np.where(product > 0.9, 4.0 * np.arcsin(np.minimum(half_chord, 1.0)), 2.0 * np.arccos(np.minimum(product, 1.0)))
        )
    )


def signal_or_parameter(signal: str, record: Record, components: Mapping[str, Component], values: Values) -> Array:
    """(rows, size) of a recorded output, or a parameter repeated for every row."""
    if signal in record:
        return np.atleast_2d(record[signal].T).T
    port(components, signal, "errors")
    value = current(components, values, *split(signal))
    return np.broadcast_to(value, (record.rows, value.size))


def errors(scenario: Scenario, record: Record, components: Mapping[str, Component], values: Values) -> dict[str, Array]:
    """Every error of the scenario over time, under its name in summary.json."""
    series = {}
    for name, measure in scenario.errors.items():
        actual, desired = (signal_or_parameter(s, record, components, values) for s in (measure.actual, measure.desired))
        if actual.shape != desired.shape:
            raise ScenarioError(f"errors.{name}: {measure.actual} and {measure.desired} differ in size")
        if name.endswith("position"):
            series[f"{name}_error_m"] = position_error(actual, desired)
        else:
            series[f"{name}_error_deg"] = orientation_error(actual, desired)
    return series


def summary(scenario: Scenario, outcome: Outcome, series: Mapping[str, Array]) -> dict[str, Any]:
    """The contract of summary.json. Values that are not finite are left out of the maxima, so that every number is one."""
    time = outcome.record.time
    last = time >= outcome.simulated - LAST
    energies = {}
    for name, signal in scenario.observed_energy.items():
        if signal not in outcome.record:
            raise ScenarioError(f"observed_energy.{name}: {signal!r} is not an output of any component")
        energies[name] = {"min": float(np.min(outcome.record[signal]))}
    return {
        "scenario": scenario.name,
        "diverged": outcome.diverged,
        "cause": outcome.cause,
        "diverged_at_s": outcome.simulated if outcome.diverged else None,
        "interrupted": outcome.interrupted,
        "simulated_s": outcome.simulated,
        "wall_s": outcome.wall,
        "steps": outcome.steps,
        **{name: {"max": finite_maximum(values), "last_10_s": finite_maximum(values[last])} for name, values in series.items()},
        "observed_energy_j": energies,
        "versions": versions(),
    }


def finite_maximum(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.max()) if finite.size else 0.0


def versions() -> dict[str, str]:
    found = {"python": platform.python_version(), "platform": platform.platform(terse=True)}
    for package in ("freeflyer-cosim", "fmpy", "casadi", "numpy", "scipy", "ziglang"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found
