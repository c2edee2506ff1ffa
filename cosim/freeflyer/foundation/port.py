"""Port: a variable of a component."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from freeflyer.foundation.errors import ComponentError

if TYPE_CHECKING:  # this package has only modules of the standard library
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

CAUSALITIES = (
    "parameter",
    "input",
    "output",
    "local",
    "independent",
    "calculatedParameter",
    "structuralParameter",
)


@dataclass(frozen=True, kw_only=True)
class Port:
    """A variable of a component.

    `units`: one item per element of the variable. The item is None if no unit is declared.
    `settable`: True for parameters, and for variables whose start value can be set, such as states.
    `choices`: names of the items of an enumeration.
    `real`: True for real variables. Only real variables can be connected and recorded.
    `direct`: for an output, the names of the inputs on which it depends at the same instant.
    `sampled`: True if an output is computed for the start of a step, even if `direct` is empty.

    An instant is a point in time at which components may start a step.
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
        if self.causality not in CAUSALITIES:
            raise ComponentError(
                f"port {self.name}: causality is {self.causality!r}; one of {', '.join(CAUSALITIES)} is expected"
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
        """Whether a step computes the output for the start of the step, and not for its end."""
        return bool(self.direct) or self.sampled


def input_writer(variables: Iterable[Array], buffer: Array) -> Callable[[], None]:
    """Return a function that copies the parts of `buffer`, one after the other, to `variables`."""
    return _copier((variable, part) for variable, part in _parts(variables, buffer))


def output_reader(variables: Iterable[Array], buffer: Array) -> Callable[[], None]:
    """Return a function that copies `variables` to the parts of `buffer`, one after the other."""
    return _copier((part, variable) for variable, part in _parts(variables, buffer))


def _parts(variables: Iterable[Array], buffer: Array) -> Iterable[tuple[Array, Array]]:
    first = 0
    for variable in variables:
        yield variable, buffer[first : first + variable.size]
        first += variable.size


def _copier(pairs: Iterable[tuple[Array, Array]]) -> Callable[[], None]:
    copied = list(pairs)

    def copy() -> None:
        for target, source in copied:
            target[:] = source

    return copy
