"""What the master steps: the protocol that FMUs, Python objects and devices share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from freeflyer.foundation import units
from freeflyer.foundation.errors import ComponentError, StepFailed

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Port:
    """A variable as the graph sees it.

    `units` has one entry per element, None where none is declared. `settable` is true for parameters and for start values
    of states. Only `real` ports can be connected and recorded. `direct` names the inputs that an output depends on at the same
    instant; `sampled` outputs are computed at the begin of a step even if they depend on none. `choices` are an enumeration's
    names.
    """

    name: str
    size: int
    causality: str
    units: tuple[str | None, ...]
    start: tuple[float, ...] | None = None
    settable: bool = False
    choices: tuple[str, ...] = ()
    boolean: bool = False
    real: bool = True
    direct: frozenset[str] = field(default_factory=frozenset)
    sampled: bool = False

    def __post_init__(self) -> None:
        causalities = (
            "parameter",
            "input",
            "output",
            "local",
            "independent",
            "calculatedParameter",
            "structuralParameter",
        )
        if self.causality not in causalities:
            raise ComponentError(
                f"port {self.name}: causality is {self.causality!r}; one of {', '.join(causalities)} is expected"
            )
        if len(self.units) != self.size or (
            self.start is not None and len(self.start) != self.size
        ):
            starts = "no" if self.start is None else len(self.start)
            raise ComponentError(
                f"port {self.name}: size is {self.size}, but it has {len(self.units)} units and {starts} start values"
            )

    @property
    def prompt(self) -> bool:
        """Whether the value of an instant is there only after the component's step that begins at that instant."""
        return bool(self.direct) or self.sampled


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


class _InPlace(dict[str, Array]):
    """Arrays that stay where they are: assigning to a name copies into its array, because the master holds on to it."""

    def __setitem__(self, name: str, value: Array) -> None:
        self[name][:] = value


def memory(ports: Iterable[Port]) -> dict[str, Array]:
    """Allocate one array for each port, filled with its start value or zeros."""
    starts = ((port.name, port.start or (0.0,) * port.size) for port in ports)
    return _InPlace((name, np.array(start, dtype=float)) for name, start in starts)


class PythonComponent:
    """A component written in Python: declare ports, then override `advance`.

    `values` holds every variable as an array under its name. Outputs whose ports are `direct` or `sampled` belong to the begin
    of a step (a controller's), the others to its end (a plant's).
    """

    variable_step = True

    def __init__(
        self, name: str, ports: Sequence[Port], values: dict[str, Array] | None = None
    ) -> None:
        """`values`: the `memory` of these ports, if it exists already."""
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
        return self._ports

    def advance(self, time: float, size: float) -> None:
        """Compute the outputs into `self.values`."""
        raise NotImplementedError

    def initialise(self, start: float) -> None:
        """Compute the outputs at the start; parameters and inputs are in `self.values`."""

    def enter_initialization(self, start: float, values: Mapping[str, Array]) -> None:
        self._start = start
        for name, value in values.items():
            if not np.isfinite(value).all():
                raise ComponentError(
                    f"{self.name}.{name} cannot be set to {value}: finite numbers are expected"
                )
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
        for name, port in self._ports.items():
            if port.causality == "output" and not np.isfinite(self.values[name]).all():
                raise StepFailed(
                    self.name,
                    f"its output {name} is {self.values[name]}; finite numbers are expected",
                )

    def close(self) -> None:
        pass
