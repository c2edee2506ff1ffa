"""Designs of experiments: grids, Latin hypercubes, random samples, one change at a time,
and named designs.

An axis varies one target of `--set`, or some elements of a vector parameter. A design has one value
of each axis.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cached_property
from typing import Any, Literal

import numpy as np

from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.units import in_unit, is_quantity

Method = Literal["latin_hypercube", "random"]
ELEMENTS = re.compile(r"^(?P<name>[^\[\]]+)\[(?P<first>\d+)(:(?P<last>\d+))?\]$")


@dataclass(frozen=True, kw_only=True)
class Target:
    """Parameter that is varied. `name` is the left side of `--set`.

    `elements` are the first and the last varied element of a vector, counted from 1. None means all
    elements.
    """

    name: str
    elements: tuple[int, int] | None = None

    @classmethod
    def parse(cls, text: str) -> Target:
        """Parse NAME, NAME[k] or NAME[first:last]. Raises ScenarioError for any other text."""
        match = ELEMENTS.match(text)
        if match is None:
            if "[" in text or "]" in text or not text.strip():
                raise ScenarioError(f"{text!r}: NAME, NAME[k] or NAME[first:last] is expected")
            return cls(name=text)
        first, last = int(match["first"]), int(match["last"] or match["first"])
        if not 1 <= first <= last:
            raise ScenarioError(
                f"{text!r}: elements are counted from 1, and the first must not exceed the last"
            )
        return cls(name=match["name"], elements=(first, last))

    def __str__(self) -> str:
        if self.elements is None:
            return self.name
        first, last = self.elements
        return f"{self.name}[{first}]" if first == last else f"{self.name}[{first}:{last}]"

    def overlaps(self, other: Target) -> bool:
        """Return whether both targets have an element in common."""
        if self.name != other.name or self.elements is None or other.elements is None:
            return self.name == other.name
        return self.elements[0] <= other.elements[1] and other.elements[0] <= self.elements[1]


@dataclass(frozen=True, kw_only=True)
class Levels:
    """List of values."""

    values: tuple[Any, ...]

    def at(self, share: float) -> Any:
        """Return the value at the fraction `share` of the list. `share` is in [0, 1)."""
        return self.values[int(share * len(self.values))]


@dataclass(frozen=True, kw_only=True)
class Interval:
    """Closed interval [low, high].

    With `multiple_of`, each value is rounded to an exact decimal multiple of `multiple_of`.
    Raises ScenarioError if a bound is invalid, or if no multiple lies between the bounds.
    """

    low: float
    high: float
    logarithmic: bool = False
    multiple_of: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ScenarioError(
                f"the interval is from {self.low!r} to {self.high!r}; two finite numbers, the lower one first, are expected"
            )
        if self.logarithmic and not self.low > 0.0:
            raise ScenarioError(
                f"the logarithmic interval starts at {self.low!r}; a number above zero is expected"
            )
        if self.multiple_of is not None:
            if not (math.isfinite(self.multiple_of) and self.multiple_of > 0.0):
                raise ScenarioError(
                    f"multiple_of is {self.multiple_of!r}; a number above zero is expected"
                )
            if self._multiples[0] > self._multiples[1]:
                raise ScenarioError(
                    f"there is no multiple of {self.multiple_of!r} from {self.low!r} to {self.high!r}"
                )

    @cached_property
    def _multiples(self) -> tuple[int, int]:
        low, high, unit = (
            Decimal(repr(float(number)))
            for number in (self.low, self.high, self.multiple_of or 1.0)
        )
        return math.ceil(low / unit), math.floor(high / unit)

    def at(self, share: float) -> float:
        """Return the value at the fraction `share` in [0, 1] of the interval.

        In a logarithmic interval, the fraction refers to the logarithm of the value.
        """
        length, span = self.high / self.low if self.logarithmic else 1.0, self.high - self.low
        value: float = self.low * length**share if self.logarithmic else self.low + share * span
        value = min(max(value, self.low), self.high)
        if self.multiple_of is None:
            return value
        # Multiply decimal numbers, because 7 x 0.1 is not exactly 0.7 with binary numbers. A period
        # must be an exact number of nanoseconds.
        unit = Decimal(repr(float(self.multiple_of)))
        least, most = self._multiples
        return float(unit * min(max(round(Decimal(value) / unit), least), most))

    def spread(self, count: int) -> Levels:
        """Return `count` equidistant values, or values with equidistant logarithms.

        Equal values after rounding are returned only once.
        """
        return Levels(values=tuple(dict.fromkeys(self.at(k / (count - 1)) for k in range(count))))


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One target and the source of its values.

    `unit` is the unit of the values. If `relative` is true, the values are factors: the value in
    the scenario is multiplied by them. `also` are further targets that get the same value or
    factor. `not_in` are cases that the axis does not change.
    """

    target: Target
    source: Levels | Interval
    unit: str | None = None
    relative: bool = False
    also: tuple[Target, ...] = ()
    not_in: tuple[str, ...] = ()

    @property
    def targets(self) -> tuple[Target, ...]:
        return (self.target, *self.also)

    def in_unit(self, unit: str) -> Axis:
        """Return this axis with numbers in `unit`, if some of its values have units.

        Raises ValueError if a value cannot be converted.
        """
        if not (isinstance(self.source, Levels) and any(map(is_quantity, self.source.values))):
            return self
        values = tuple(in_unit(value, unit) for value in self.source.values)
        return replace(self, source=Levels(values=values), unit=unit)


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Random sample with `count` draws. A draw has one value for each axis in `axes`."""

    method: Method
    count: int
    seed: int
    axes: tuple[Axis, ...]

    @cached_property
    def rows(self) -> list[tuple[Any, ...]]:
        """Draws (count, axes). Equal seeds give equal draws."""
        generator = np.random.default_rng(self.seed)
        size = len(self.axes)
        if self.method == "latin_hypercube":
            # This module is imported here, because the import takes one second.
            from scipy.stats import qmc

            shares = qmc.LatinHypercube(d=size, rng=generator).random(self.count)
        else:
            shares = generator.random((self.count, size))
        return [
            tuple(axis.source.at(float(share)) for axis, share in zip(self.axes, row, strict=True))
            for row in shares
        ]


UNCHANGED = None
"""Value of an axis in a design that keeps the value of the scenario."""


@dataclass(frozen=True, kw_only=True)
class OneAtATime:
    """Designs that change one axis. The first design changes no axis. All axes have levels."""

    axes: tuple[Axis, ...]

    @property
    def grid(self) -> tuple[Axis, ...]:
        return self.axes

    def mapped(self, change: Callable[[Axis], Axis]) -> OneAtATime:
        """Return these designs with `change` applied to each axis."""
        return OneAtATime(axes=tuple(map(change, self.axes)))

    @cached_property
    def levels(self) -> list[tuple[Any, ...]]:
        """Values of each axis."""
        return [axis.source.values for axis in self.axes if isinstance(axis.source, Levels)]

    @cached_property
    def _changes(self) -> list[tuple[int, Any]]:
        return [(place, value) for place, values in enumerate(self.levels) for value in values]

    @property
    def count(self) -> int:
        """Number of designs."""
        return 1 + sum(map(len, self.levels))

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, number: int) -> tuple[Any, ...]:
        """Return the values of all axes in design `number` >= 0. Raises IndexError."""
        point: list[Any] = [UNCHANGED] * len(self.axes)
        if number > 0:
            place, value = self._changes[number - 1]
            point[place] = value
        return tuple(point)


DESIGN = "design_name"
"""Name of the column with the names of named designs."""


@dataclass(frozen=True, kw_only=True)
class NamedDesigns:
    """Designs with a name. Each design sets its own targets to fixed values."""

    settings: Mapping[str, Mapping[str, Any]]
    grid: tuple[Axis, ...] = ()

    @property
    def axes(self) -> tuple[Axis, ...]:
        return (Axis(target=Target(name=DESIGN), source=Levels(values=tuple(self.settings))),)

    def mapped(self, change: Callable[[Axis], Axis]) -> NamedDesigns:
        """Return these designs. The values of their only axis are names."""
        return self

    @property
    def levels(self) -> list[tuple[Any, ...]]:
        return []

    @property
    def count(self) -> int:
        """Number of designs."""
        return len(self.settings)

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, number: int) -> tuple[Any, ...]:
        """Return the name of design `number` >= 0. Raises IndexError."""
        return (list(self.settings)[number],)


@dataclass(frozen=True, kw_only=True)
class Designs:
    """All combinations of a grid point and a draw.

    A grid point has one value for each axis of the grid. In the order of the designs, the draw
    changes fastest. Then the last axis of the grid changes.
    """

    grid: tuple[Axis, ...]
    sample: Sample | None

    @property
    def axes(self) -> tuple[Axis, ...]:
        return self.grid + (self.sample.axes if self.sample else ())

    def mapped(self, change: Callable[[Axis], Axis]) -> Designs:
        """Return these designs with `change` applied to each axis."""
        sample = self.sample and replace(self.sample, axes=tuple(map(change, self.sample.axes)))
        return Designs(grid=tuple(map(change, self.grid)), sample=sample)

    @property
    def levels(self) -> list[tuple[Any, ...]]:
        """Values of each grid axis."""
        return [axis.source.values for axis in self.grid if isinstance(axis.source, Levels)]

    @property
    def count(self) -> int:
        """Number of designs. Python limits the result of `len` to 64 bits, but not this number."""
        return math.prod(map(len, self.levels)) * (self.sample.count if self.sample else 1)

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, number: int) -> tuple[Any, ...]:
        """Return the values of all axes in design `number` >= 0. Raises IndexError."""
        if not 0 <= number < len(self):
            raise IndexError(number)
        drawn: Sequence[Any] = ()
        if self.sample:
            number, draw = divmod(number, self.sample.count)
            drawn = self.sample.rows[draw]
        point: list[Any] = []
        for values in reversed(self.levels):
            number, place = divmod(number, len(values))
            point.insert(0, values[place])
        return (*point, *drawn)
