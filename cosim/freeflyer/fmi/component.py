"""Protocol of the components that the master steps.

FMUs, Python components and devices implement this protocol.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from freeflyer.foundation import units
from freeflyer.foundation.errors import ComponentError, StepFailed
from freeflyer.foundation.port import Port as Port
from freeflyer.foundation.port import input_writer, output_reader

Array = NDArray[np.float64]


class Component(Protocol):
    """A component that the master steps.

    `bind_inputs` returns a function, the input writer. `bind_outputs` returns a function, the
    output reader. The master calls methods, writers and readers in this order:

    1. At the start: `enter_initialization`, input writers, `exit_initialization`, output readers.
    2. For every step: input writers, `step`, output readers.
    3. At the end: `close`. A call of `close` is allowed at any time.
    """

    name: str
    variable_step: bool
    """Whether the last step may be shorter than the other steps."""

    @property
    def ports(self) -> Mapping[str, Port]: ...

    def enter_initialization(self, start: float, values: Mapping[str, Array]) -> None:
        """Set parameters and start values, for a run that begins at the time `start` [s].

        `values` maps names of variables to values [SI].

        Raises ComponentError if a value is rejected.
        """

    def exit_initialization(self) -> None:
        """Compute the outputs at the start time.

        Raises ComponentError if the component cannot start from its start values.
        """

    def bind_inputs(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        """Return a function that writes `buffer` to the named inputs.

        `buffer` is one-dimensional and contains the inputs in the order of `names`.
        """

    def bind_outputs(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        """Return a function that reads the named outputs into `buffer`.

        `buffer` is one-dimensional and contains the outputs in the order of `names`.
        """

    def step(self, time: float, size: float) -> None:
        """Step from `time` to `time + size` [s]. Raises StepFailed if the step fails."""

    def close(self) -> None:
        """Release all resources."""


class _FixedArrays(dict[str, Array]):
    """Arrays with fixed memory, by name.

    The master keeps references to this memory. Therefore an assignment copies the value into the
    existing array.
    """

    def __setitem__(self, name: str, value: Array) -> None:
        self[name][:] = value


def memory(ports: Iterable[Port]) -> dict[str, Array]:
    """Return one array for each of the `ports`, by name: the memory of a component.

    An array has the size of its port and contains the start value, or zeros. The keys are fixed:
    another key raises KeyError. A new value is copied into the array, so the array stays the same.
    Raises ValueError if such a value has another size.
    """
    starts = ((port.name, port.start or (0.0,) * port.size) for port in ports)
    return _FixedArrays((name, np.array(start, dtype=float)) for name, start in starts)


class PythonComponent:
    """Base class of components that are written in Python.

    A subclass declares ports and overrides `advance`. `values` contains each variable as an array,
    by name. If the port of an output has `direct` inputs or is `sampled`, `advance` computes this
    output for the start of the step. Controllers have such outputs. `advance` computes any other
    output for the end of the step. Plants have such outputs.
    """

    variable_step = True

    def __init__(
        self, name: str, ports: Sequence[Port], values: dict[str, Array] | None = None
    ) -> None:
        """Allocate the arrays of the variables, unless `values` is given.

        If `values` is given, it must be the result of `memory(ports)`. Raises ComponentError if the
        unit of a port is unknown.
        """
        self.name = name
        self._ports = {port.name: port for port in ports}
        for port in ports:
            for unit in set(port.units) - {None}:
                try:
                    units.unit(str(unit))
                except ValueError as error:
                    raise ComponentError(f"component {name}: port {port.name}: {error}") from error
        self.values = memory(ports) if values is None else values

    @property
    def ports(self) -> Mapping[str, Port]:
        """Variables by name."""
        return self._ports

    def advance(self, time: float, size: float) -> None:
        """Compute the outputs in `self.values` for the step from `time` to `time + size` [s]."""
        raise NotImplementedError

    def initialise(self, start: float) -> None:
        """Compute the outputs in `self.values` at the time `start` [s]."""

    def enter_initialization(self, start: float, values: Mapping[str, Array]) -> None:
        """Set start values, and enter the initialization mode at the time `start` [s]."""
        self._start = start
        for name, value in values.items():
            if not np.isfinite(value).all():
                raise ComponentError(
                    f"{self.name}.{name} cannot be set to {value}: finite numbers are expected"
                )
            self.values[name][:] = value

    def exit_initialization(self) -> None:
        """Leave the initialization mode."""
        self.initialise(self._start)

    def bind_inputs(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        """Return a function that copies `buffer` into the inputs `names`."""
        return input_writer([self.values[name] for name in names], buffer)

    def bind_outputs(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        """Return a function that copies the outputs `names` into `buffer`."""
        return output_reader([self.values[name] for name in names], buffer)

    def step(self, time: float, size: float) -> None:
        """Advance from `time` by `size`. Both are in s."""
        self.advance(time, size)
        for name, port in self._ports.items():
            if port.causality == "output" and not np.isfinite(self.values[name]).all():
                raise StepFailed(
                    self.name,
                    f"its output {name} is {self.values[name]}; finite numbers are expected",
                )

    def close(self) -> None:
        """Release the component."""
        pass
