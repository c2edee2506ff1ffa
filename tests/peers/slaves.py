"""FMUs for the peers: variables as arrays in both FMI versions, and FMPy's slaves as one class."""

from __future__ import annotations

import contextlib
import re
import shutil
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray

Array = NDArray[np.float64]
Value = float | int | bool | Sequence[float]
Connection = tuple[str, str]
StartValues = Mapping[str, Mapping[str, Value]]


@dataclass(frozen=True)
class Variable:
    """An array has a name and a reference per element in FMI 2.0, and one of each in FMI 3.0."""

    kind: str
    size: int
    names: tuple[str, ...]
    references: tuple[int, ...]
    start: tuple[float, ...] | None


def read_variables(path: Path, *, validate: bool = True) -> tuple[Any, dict[str, Variable]]:
    description = fmpy.read_model_description(str(path), validate=validate)
    groups: dict[str, list[Any]] = {}
    for variable in description.modelVariables:
        groups.setdefault(variable.name.partition("[")[0], []).append(variable)
    found = {}
    for name, group in groups.items():
        size = sum(
            int(np.prod([int(dimension.start) for dimension in v.dimensions] or [1])) for v in group
        )
        kind = {"Float64": "Real", "Int32": "Integer", "Int64": "Integer"}.get(
            group[0].type, group[0].type
        )
        items = (
            [item for v in group for item in str(v.start or "").split()] if kind == "Real" else []
        )
        start = tuple(float(item) for item in items) if len(items) == size else None
        found[name] = Variable(
            kind, size, tuple(v.name for v in group), tuple(v.valueReference for v in group), start
        )
    return description, found


def variables_of(fmus: Mapping[str, Path]) -> dict[str, dict[str, Variable]]:
    return {name: read_variables(path)[1] for name, path in fmus.items()}


def with_integers(
    fmus: Mapping[str, Path], start_values: StartValues, folder: Path
) -> dict[str, Path]:
    """Return the FMUs with integers in place of enumerations, for masters without enumerations.

    FMI 2.0 sets both types by the same function. Therefore only the model description changes. If
    no start value is an enumeration, the FMUs stay as they are.
    """
    variables = variables_of(fmus)
    kinds = {variables[name][key].kind for name, values in start_values.items() for key in values}
    if "Enumeration" not in kinds:
        return dict(fmus)
    return {name: _with_integers(path, folder / f"{name}.fmu") for name, path in fmus.items()}


def _with_integers(path: Path, out: Path) -> Path:
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        for entry in old.namelist():
            data = old.read(entry)
            if entry == "modelDescription.xml":
                data = re.sub(
                    rb'<Enumeration start="(\d+)" declaredType="[^"]*"',
                    rb'<Integer start="\1"',
                    data,
                )
            new.writestr(entry, data)
    return out


def split(signal: str) -> tuple[str, str]:
    component, _, variable = signal.partition(".")
    return component, variable


def elements(value: Value, size: int) -> list[Any]:
    """Return one number per element; a single value is repeated."""
    items = list(value) if isinstance(value, Sequence) else [value]
    return items * size if len(items) == 1 else items


def ticks(steps: Mapping[str, float], stop: float) -> tuple[float, dict[str, int], int]:
    """Return the smallest step, all steps as multiples of it, and the number of smallest steps."""
    smallest = min(steps.values())
    return (
        smallest,
        {name: round(step / smallest) for name, step in steps.items()},
        round(stop / smallest),
    )


def times(first: int, last: int, size: float) -> Array:
    return np.arange(first, last + 1, dtype=np.float64) * size


class Slave:
    """FMPy's FMU2Slave or FMU3Slave, with arrays by name."""

    def __init__(self, name: str, path: Path, *, validate: bool = True) -> None:
        description, self.variables = read_variables(path, validate=validate)
        self._directory = fmpy.extract(str(path))
        self._two = description.fmiVersion.startswith("2")
        made = (FMU2Slave if self._two else FMU3Slave)(
            guid=description.guid,
            unzipDirectory=self._directory,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        made.instantiate()
        self._fmu: Any = made

    def set(self, name: str, value: Value | Array) -> None:
        variable = self.variables[name]
        items = elements(value.tolist() if isinstance(value, np.ndarray) else value, variable.size)
        kind = variable.kind
        if kind == "Real":
            (self._fmu.setReal if self._two else self._fmu.setFloat64)(variable.references, items)
        elif kind == "Boolean":
            self._fmu.setBoolean(variable.references, items)
        else:  # an enumeration
            (self._fmu.setInteger if self._two else self._fmu.setInt64)(variable.references, items)

    def get(self, name: str) -> Array:
        variable = self.variables[name]
        if self._two:
            return np.array(self._fmu.getReal(variable.references))
        return np.array(self._fmu.getFloat64(variable.references, nValues=variable.size))

    def enter_initialization(self, values: Mapping[str, Value]) -> None:
        for name, value in values.items():
            self.set(name, value)
        if self._two:
            self._fmu.setupExperiment(startTime=0.0)
        self._fmu.enterInitializationMode()

    def exit_initialization(self) -> None:
        self._fmu.exitInitializationMode()

    def step(self, time: float, size: float) -> None:
        self._fmu.doStep(currentCommunicationPoint=time, communicationStepSize=size)

    def close(self) -> None:
        with contextlib.suppress(FMICallException):  # a failed instance may reject terminate()
            self._fmu.terminate()
        self._fmu.freeInstance()
        shutil.rmtree(self._directory, ignore_errors=True)
