"""One FMU instance through FMPy, with arrays by name, for both FMI versions."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException
from fmpy.model_description import read_model_description

from freeflyer_fmus.robot.robot import Array


class Instance:
    """A new instance; `options` are arguments of FMPy's `instantiate`."""

    def __init__(self, path: Path, *, model_exchange: bool = False, **options: Any) -> None:
        self.description = read_model_description(str(path))
        self.version = int(self.description.fmiVersion[0])
        self.references: dict[str, list[int]] = {}
        self.sizes: dict[str, int] = {}
        for variable in self.description.modelVariables:
            name = variable.name
            if "[" in name:  # x[1], or der(x[1]) for a derivative in FMI 2.0
                name = name.partition("[")[0] + (")" if name.startswith("der(") else "")
            self.references.setdefault(name, []).append(variable.valueReference)
            self.sizes[name] = self.sizes.get(name, 0) + int(
                np.prod([int(d.start) for d in variable.dimensions] or [1])
            )
        self._directory = fmpy.extract(str(path))
        kinds = {2: (fmi2.FMU2Slave, fmi2.FMU2Model), 3: (fmi3.FMU3Slave, fmi3.FMU3Model)}
        self.fmu: Any = kinds[self.version][model_exchange](
            guid=self.description.guid,
            unzipDirectory=self._directory,
            modelIdentifier=path.stem,
            instanceName="instance",
        )
        self.messages: list[str] = []
        if self.version == 3:
            options["logMessage"] = lambda _, status, category, message: self.messages.append(
                message.decode()
            )
        self.fmu.instantiate(**options)

    def initialise(self, start: float = 0.0) -> Instance:
        self.enter(start)
        self.fmu.exitInitializationMode()
        return self

    def enter(self, start: float = 0.0) -> None:
        if self.version == 2:
            self.fmu.setupExperiment(startTime=start)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start)

    def set(self, name: str, values: Array | Sequence[float] | float) -> None:
        numbers = [float(x) for x in np.atleast_1d(values)]
        (self.fmu.setReal if self.version == 2 else self.fmu.setFloat64)(
            self.references[name], numbers
        )

    def choose(self, name: str, value: int) -> None:
        (self.fmu.setInteger if self.version == 2 else self.fmu.setInt64)(
            self.references[name], [value]
        )

    def switch(self, name: str, value: bool) -> None:
        self.fmu.setBoolean(self.references[name], [value])

    def get(self, name: str) -> Array:
        if self.version == 2:
            return np.array(self.fmu.getReal(self.references[name]))
        return np.array(self.fmu.getFloat64(self.references[name], nValues=self.sizes[name]))

    def all_outputs(self) -> Array:
        return np.concatenate([self.get(name) for name in self.outputs])

    @property
    def outputs(self) -> list[str]:
        return self._having("output")

    @property
    def inputs(self) -> list[str]:
        return self._having("input")

    def _having(self, causality: str) -> list[str]:
        found = {
            v.valueReference for v in self.description.modelVariables if v.causality == causality
        }
        return [name for name, references in self.references.items() if references[0] in found]

    def step(self, time: float, size: float) -> Any:
        return self.fmu.doStep(time, size)

    # States

    def save(self) -> bytes:
        if self.version == 2:
            state = self.fmu.getFMUstate()
            packed = bytes(self.fmu.serializeFMUstate(state))
            self.fmu.freeFMUstate(state)
        else:
            state = self.fmu.getFMUState()
            packed = bytes(self.fmu.serializeFMUState(state))
            self.fmu.freeFMUState(state)
        return packed

    def restore(self, packed: bytes) -> None:
        if self.version == 2:
            state = self.fmu.deSerializeFMUstate(packed)
            self.fmu.setFMUstate(state)
            self.fmu.freeFMUstate(state)
        else:
            state = self.fmu.deserializeFMUState(packed)
            self.fmu.setFMUState(state)
            self.fmu.freeFMUState(state)

    # Sensitivities

    def directional(self, unknowns: Sequence[str], knowns: Sequence[str], seed: Array) -> Array:
        unknown = [reference for name in unknowns for reference in self.references[name]]
        known = [reference for name in knowns for reference in self.references[name]]
        if self.version == 2:
            return np.array(self.fmu.getDirectionalDerivative(unknown, known, list(seed)))
        size = sum(self.sizes[name] for name in unknowns)
        return np.array(self.fmu.getDirectionalDerivative(unknown, known, list(seed), size))

    def adjoint(self, unknowns: Sequence[str], knowns: Sequence[str], seed: Array) -> Array:
        unknown = [reference for name in unknowns for reference in self.references[name]]
        known = [reference for name in knowns for reference in self.references[name]]
        size = sum(self.sizes[name] for name in knowns)
        return np.array(self.fmu.getAdjointDerivative(unknown, known, list(seed), size))

    def width(self, names: Sequence[str]) -> int:
        return sum(self.sizes[name] for name in names)

    def close(self) -> None:
        with contextlib.suppress(FMICallException):
            self.fmu.terminate()
        self.fmu.freeInstance()
        shutil.rmtree(self._directory, ignore_errors=True)
