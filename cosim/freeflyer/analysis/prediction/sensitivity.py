"""Exact partial derivatives of a co-simulation FMU, from its directional derivatives."""

from __future__ import annotations

import ctypes
import zipfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelVariable

from freeflyer.fmi.component import Array
from freeflyer.fmi.fmu import FmuComponent
from freeflyer.foundation.errors import ComponentError
from freeflyer.foundation.own_fmus import OWN_TOOL


def _provides_derivatives(path: Path) -> bool:
    """Return whether the FMU provides directional derivatives.

    The name of the attribute is different in FMI 2.0 and FMI 3.0. FMPy reads only the name of FMI
    2.0. Therefore this function reads the attribute from the model description.
    """
    with zipfile.ZipFile(path) as archive:
        interface = ElementTree.fromstring(archive.read("modelDescription.xml")).find(
            "CoSimulation"
        )
    spellings = ("providesDirectionalDerivative", "providesDirectionalDerivatives")
    return interface is not None and any(interface.get(name) in ("true", "1") for name in spellings)


class DifferentiableFmu(FmuComponent):
    """FMU that gives directional derivatives at its present states and inputs.

    The element ModelStructure of a co-simulation FMU can list the derivatives of its continuous
    states, in FMI 2.0 and 3.0. This class finds the continuous states in this list.
    """

    def __init__(self, name: str, path: Path) -> None:
        """Load the FMU. Raises ComponentError if it has no directional derivatives."""
        super().__init__(name, path)
        self._started = False
        if not _provides_derivatives(path):
            self.close()
            raise ComponentError(
                f"FMU {path} of component {name} provides no directional derivatives; its loop can be simulated, but not linearised"
            )
        self._rates: dict[str, list[ModelVariable]] = {}
        owner = {id(variable): port for port in self.ports for variable in self.variables_of(port)}
        for unknown in self.description.derivatives:
            self._rates.setdefault(owner[id(unknown.variable.derivative)], []).append(
                unknown.variable
            )

    @property
    def states(self) -> Sequence[str]:
        """Ports that are continuous states, in the order of ModelStructure.

        A sampled FMU has no continuous states.
        """
        return tuple(self._rates)

    @property
    def discrete_states(self) -> Sequence[str]:
        """Ports that are the memory of a sampled FMU of this project.

        FMI has no derivatives by discrete states. Therefore FMUs of other tools are not asked.
        """
        if self.description.generationTool != OWN_TOOL or self._rates:
            return ()
        states = []
        for name in self.ports:
            first = self.variables_of(name)[0]
            if first.causality in ("local", "output") and first.variability == "discrete":
                with suppress(ComponentError):  # an output that is not a state is rejected
                    self.bind_derivative([name], [name])()
                    states.append(name)
        return tuple(states)

    def bind_derivative(
        self, unknowns: Sequence[str], knowns: Sequence[str]
    ) -> Callable[[], Array]:
        """Return a function that computes the derivatives of `unknowns` with respect to `knowns`.

        An unknown is an output, a state, or a state derivative `der(STATE)`. A known is an input or
        a state. A discrete state is the value before a sample as a known, and the value after it as
        an unknown. The function returns a Jacobian with one row for each element of the unknowns
        and one column for each element of the knowns. It raises ComponentError if the FMU returns
        an error.
        """
        # The buffers of all calls are allocated once, because the function is called often.
        results, rows = self._references(unknowns)
        known = [
            (variable.valueReference, self._size(variable))
            for name in knowns
            for variable in self._variables_of(name)
        ]
        columns = sum(size for _, size in known)
        found, slave, instance = (
            (ctypes.c_double * max(rows, 1))(),
            self._slave,
            self._slave.component,
        )
        # Prepare one call for each known element. The seed is the unit vector of this element.
        calls: list[tuple[Any, ...]] = []
        for reference, size in known:
            given = (ctypes.c_uint32 * 1)(reference)
            for element in range(size):
                seed = (ctypes.c_double * size)(*(float(k == element) for k in range(size)))
                if self.version == 2:
                    calls.append((instance, results, len(results), given, 1, seed, found))
                else:
                    calls.append(
                        (instance, results, len(results), given, 1, seed, size, found, rows)
                    )
        # `buffer` is a view of the C array `found`. Each call writes its result to this array.
        call = (
            slave.fmi2GetDirectionalDerivative
            if self.version == 2
            else slave.fmi3GetDirectionalDerivative
        )
        buffer = np.ctypeslib.as_array(found)[:rows]

        def derivative() -> Array:
            matrix = np.empty((rows, columns))
            try:
                for column, arguments in enumerate(calls):
                    call(*arguments)
                    matrix[:, column] = buffer
            except (FMICallException, OSError) as error:
                raise ComponentError(f"component {self.name}: {self._reason(error)}") from error
            return matrix

        return derivative

    def rates(self) -> Array:
        """Return the present derivatives of all states, in the order of `states`."""
        variables = [variable for group in self._rates.values() for variable in group]
        references = [variable.valueReference for variable in variables]
        try:
            if self.version == 2:
                return np.array(self._slave.getReal(references))
            return np.array(
                self._slave.getFloat64(references, nValues=sum(self._size(v) for v in variables))
            )
        except (FMICallException, OSError) as error:
            raise ComponentError(f"component {self.name}: {self._reason(error)}") from error

    def enter_initialization(self, start: float, values: Mapping[str, Array]) -> None:
        """Enter initialization mode. If the FMU was started before, it is reset first.

        This class needs the reset for `restart`. The class FmuComponent itself has no reset.
        """
        if self._started:
            try:
                self._slave.reset()
            except (FMICallException, OSError) as error:
                raise ComponentError(
                    f"component {self.name} cannot be reset: {self._reason(error)}"
                ) from error
        self._started = True
        super().enter_initialization(start, values)

    def restart(self, values: Mapping[str, Array]) -> None:
        """Restart with `values` as parameters, start values and inputs. Raises ComponentError."""
        self.enter_initialization(0.0, values)
        self.exit_initialization()

    def _variables_of(self, name: str) -> Sequence[ModelVariable]:
        if name.startswith("der(") and name[4:-1] in self._rates:
            return self._rates[name[4:-1]]
        return self.variables_of(name)

    def _references(self, names: Sequence[str]) -> tuple[ctypes.Array[ctypes.c_uint32], int]:
        variables = [variable for name in names for variable in self._variables_of(name)]
        references = (ctypes.c_uint32 * len(variables))(
            *(variable.valueReference for variable in variables)
        )
        return references, sum(self._size(variable) for variable in variables)

    @staticmethod
    def _size(variable: ModelVariable) -> int:
        return int(np.prod([int(dimension.start or 1) for dimension in variable.dimensions] or [1]))
