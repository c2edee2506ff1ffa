"""ecos through `ecospy`: FMI 2.0, and FMI 3.0 without arrays. Needs libtbb12.

Its exchange rule is Rule(rounds=number of components) of reference_loops.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure
from slaves import (
    Array,
    Connection,
    StartValues,
    Variable,
    elements,
    split,
    ticks,
    times,
    variables_of,
    with_integers,
)


class EcosError(Exception):
    """An error of ecos, or a feature that ecos would execute wrongly without an error."""


def run(
    fmus: Mapping[str, Path],
    connections: Sequence[Connection],
    start_values: StartValues,
    steps: Mapping[str, float],
    stop: float,
    recorded: Sequence[str],
) -> dict[str, Array]:
    with tempfile.TemporaryDirectory() as folder:
        fmus = with_integers(fmus, start_values, Path(folder))
        return _run(fmus, connections, start_values, steps, stop, recorded)


def _run(
    fmus: Mapping[str, Path],
    connections: Sequence[Connection],
    start_values: StartValues,
    steps: Mapping[str, float],
    stop: float,
    recorded: Sequence[str],
) -> dict[str, Array]:
    variables = variables_of(fmus)
    for name, own in variables.items():
        if any(variable.size > len(variable.names) for variable in own.values()):
            raise EcosError(
                f"{name} has arrays of FMI 3.0: ecos treats them as scalars and gets no error"
            )
    size, _, count = ticks(steps, stop)
    EcosLib.set_log_level("warn")
    parameters: dict[str, float | int | bool] = {}
    for name, values in start_values.items():
        for variable, value in values.items():
            found = variables[name][variable]
            cast = {"Boolean": bool, "Integer": int}.get(found.kind, float)
            for element, item in zip(found.names, elements(value, found.size), strict=True):
                parameters[f"{name}::{element}"] = cast(item)
    with EcosSimulationStructure() as structure:
        for name, path in fmus.items():
            structure.add_model(name, str(path), steps[name])
        for source, target in connections:
            (start, output), (end, input_) = split(source), split(target)
            for a, b in zip(
                variables[start][output].names, variables[end][input_].names, strict=True
            ):
                structure.make_real_connection(f"{start}::{a}", f"{end}::{b}")
        structure.add_parameter_set("start", parameters)
        with EcosSimulation(structure=structure, step_size=size) as simulation:
            return _simulate(simulation, variables, recorded, size, count)


def run_ssp(
    path: Path, fmus: Mapping[str, Path], size: float, stop: float, recorded: Sequence[str]
) -> dict[str, Array]:
    """Run an SSP file. Its OSP annotations contain the steps; the caller gives the base step."""
    with EcosSimulation(ssp_path=str(path), step_size=size) as simulation:
        return _simulate(simulation, variables_of(fmus), recorded, size, round(stop / size))


def _simulate(
    simulation: EcosSimulation,
    variables: Mapping[str, Mapping[str, Variable]],
    recorded: Sequence[str],
    size: float,
    count: int,
) -> dict[str, Array]:
    signals = {signal: variables[split(signal)[0]][split(signal)[1]].names for signal in recorded}
    record = {signal: np.empty((count + 1, len(names))) for signal, names in signals.items()}
    record["time"] = times(0, count, size)
    if not simulation.init(parameter_set="start"):
        raise EcosError(EcosLib.get_last_error())
    for k in range(count + 1):
        for signal, names in signals.items():
            record[signal][k] = [
                simulation.get_real(f"{split(signal)[0]}::{name}") for name in names
            ]
        if k < count:
            simulation.step()
    simulation.terminate()
    return record
