"""What the master steps: the protocol that FMUs, Python objects and devices share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cosim.errors import ComponentError

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Port:
    """A variable as the graph sees it.

    `units` has one entry per element, None where none is declared. `settable` is true for parameters and for start values
    of states. `direct` names the inputs that an output depends on at the same instant. `choices` are an enumeration's names.
    """

    name: str
    size: int
    causality: str
    units: tuple[str | None, ...]
    start: tuple[float, ...] | None = None
    settable: bool = False
    choices: tuple[str, ...] = ()
    boolean: bool = False
    direct: frozenset[str] = field(default_factory=frozenset)


class Component(Protocol):
    """One slave. Calls come in this order: enter_initialization, input writers, exit_initialization, output readers; then
    for every step the input writers, `step`, and the output readers; at last `close`, which may come at any time.
    """

    name: str
    variable_step: bool
    """Whether a step may be shorter than the others (the last one of a run)."""

    @property
    def ports(self) -> Mapping[str, Port]: ...

    def enter_initialization(self, start: float, values: Mapping[str, Array]) -> None:
        """Set parameters and start values [SI]; ComponentError if one is refused."""

    def exit_initialization(self) -> None:
        """ComponentError if the component cannot start from its values."""

    def bind_inputs(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        """A function that hands the buffer's current contents (the named inputs, one after the other) to the component."""

    def bind_outputs(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        """A function that reads the named outputs into the buffer."""

    def step(self, time: float, size: float) -> None:
        """From `time` to `time + size` [s]; StepFailed if that cannot be done."""

    def close(self) -> None: ...


class PythonComponent:
    """A component written in Python: declare ports, then override `advance`.

    `values` holds every variable as an array under its name. With `samples = True` the outputs of `advance` belong to the
    begin of the step (a controller); else to its end (a plant).
    """

    variable_step = True

    def __init__(self, name: str, ports: Sequence[Port]) -> None:
        self.name = name
        self._ports = {port.name: port for port in ports}
        self.values: dict[str, Array] = {
            port.name: np.array(port.start if port.start is not None else np.zeros(port.size), dtype=float) for port in ports
        }

    @property
    def ports(self) -> Mapping[str, Port]:
        return self._ports

    def advance(self, time: float, size: float) -> None:
        """Change `self.values` of the outputs in place."""
        raise NotImplementedError

    def initialise(self, start: float) -> None:
        """Compute the outputs at the start; parameters and inputs are in `self.values`."""

    def enter_initialization(self, start: float, values: Mapping[str, Array]) -> None:
        self._start = start
        for name, value in values.items():
            if not np.isfinite(value).all():
                raise ComponentError(f"{self.name}.{name} cannot be set to {value}: finite numbers are expected")
            self.values[name][:] = value

    def exit_initialization(self) -> None:
        self.initialise(self._start)

    def bind_inputs(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        parts = self._parts(names, buffer)

        def write() -> None:
            for own, part in parts:
                own[:] = part

        return write

    def bind_outputs(self, names: Sequence[str], buffer: Array) -> Callable[[], None]:
        parts = self._parts(names, buffer)

        def read() -> None:
            for own, part in parts:
                part[:] = own

        return read

    def _parts(self, names: Sequence[str], buffer: Array) -> list[tuple[Array, Array]]:
        parts, first = [], 0
        for name in names:
            own = self.values[name]
            parts.append((own, buffer[first : first + own.size]))
            first += own.size
        return parts

    def step(self, time: float, size: float) -> None:
        self.advance(time, size)

    def close(self) -> None:
        pass
