"""Designs of experiments: grids, Latin hypercubes and random draws over targets of `--set`, and over elements of vectors."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property
from typing import Any, Literal

import numpy as np

from freeflyer.foundation.errors import ScenarioError

Method = Literal["latin_hypercube", "random"]
ELEMENTS = re.compile(r"^(?P<name>[^\[\]]+)\[(?P<first>\d+)(:(?P<last>\d+))?\]$")


@dataclass(frozen=True, kw_only=True)
class Target:
    """What is varied: a target of `--set`, or the elements first ... last (counted from 1) of a vector."""

    name: str
    elements: tuple[int, int] | None = None

    @classmethod
    def parse(cls, text: str) -> Target:
        """NAME, NAME[k] or NAME[first:last]; ScenarioError for anything else."""
        match = ELEMENTS.match(text)
        if match is None:
            if "[" in text or "]" in text:
                raise ScenarioError(f"{text!r}: NAME, NAME[k] or NAME[first:last] is expected")
            return cls(name=text)
        first, last = int(match["first"]), int(match["last"] or match["first"])
        if not 1 <= first <= last:
            raise ScenarioError(f"{text!r}: elements are counted from 1, the first one first")
        return cls(name=match["name"], elements=(first, last))

    def __str__(self) -> str:
        if self.elements is None:
            return self.name
        first, last = self.elements
        return f"{self.name}[{first}]" if first == last else f"{self.name}[{first}:{last}]"

    def overlaps(self, other: Target) -> bool:
        if self.name != other.name or self.elements is None or other.elements is None:
            return self.name == other.name
        return self.elements[0] <= other.elements[1] and other.elements[0] <= self.elements[1]


@dataclass(frozen=True, kw_only=True)
class Levels:
    """Values that are given one by one."""

    values: tuple[Any, ...]

    def at(self, share: float) -> Any:
        """The value at a share in [0, 1) of them."""
        return self.values[int(share * len(self.values))]


@dataclass(frozen=True, kw_only=True)
class Interval:
    """Numbers from `low` to `high`, both included; `multiple_of` rounds to whole multiples, exact as decimal numbers."""

    low: float
    high: float
    logarithmic: bool = False
    multiple_of: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ScenarioError(
                f"it goes from {self.low!r} to {self.high!r}; two finite numbers, the lower one first, are expected"
            )
        if self.logarithmic and not self.low > 0.0:
            raise ScenarioError(
                f"it is logarithmic and begins at {self.low!r}; a number above zero is expected"
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
        """The value at a share in [0, 1] of the interval, or of its logarithm."""
        length, span = self.high / self.low if self.logarithmic else 1.0, self.high - self.low
        value: float = self.low * length**share if self.logarithmic else self.low + share * span
        value = min(max(value, self.low), self.high)
        if self.multiple_of is None:
            return value
        # A period is a whole number of nanoseconds only as a decimal number: 7 x 0.1 is not 0.7 otherwise.
        unit = Decimal(repr(float(self.multiple_of)))
        least, most = self._multiples
        return float(unit * min(max(round(Decimal(value) / unit), least), most))

    def spread(self, count: int) -> Levels:
        """`count` values at equal distances (of the logarithm); those that rounding makes equal count once."""
        return Levels(values=tuple(dict.fromkeys(self.at(k / (count - 1)) for k in range(count))))


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One target and where its values are from. `relative`: factors on the scenario's own value; `unit`: of the values; `also`:
    targets that take the same value, or factor.
    """

    target: Target
    source: Levels | Interval
    unit: str | None = None
    relative: bool = False
    also: tuple[Target, ...] = ()

    @property
    def targets(self) -> tuple[Target, ...]:
        return (self.target, *self.also)


@dataclass(frozen=True, kw_only=True)
class Sample:
    """`count` draws of all axes together."""

    method: Method
    count: int
    seed: int
    axes: tuple[Axis, ...]

    @cached_property
    def rows(self) -> list[tuple[Any, ...]]:
        """(count, axes). The same seed gives the same draws."""
        generator = np.random.default_rng(self.seed)
        size = len(self.axes)
        if self.method == "latin_hypercube":
            from scipy.stats import (
                qmc,
            )  # it takes a second, which every other command would pay for too

            shares = qmc.LatinHypercube(d=size, rng=generator).random(self.count)
        else:
            shares = generator.random((self.count, size))
        return [
            tuple(axis.source.at(float(share)) for axis, share in zip(self.axes, row, strict=True))
            for row in shares
        ]


@dataclass(frozen=True, kw_only=True)
class Designs:
    """Every point of the grid with every draw of the sample; the last axis of the grid, and then the draws, change fastest."""

    grid: tuple[Axis, ...]
    sample: Sample | None

    @property
    def axes(self) -> tuple[Axis, ...]:
        return self.grid + (self.sample.axes if self.sample else ())

    @property
    def levels(self) -> list[tuple[Any, ...]]:
        """Of the grid's axes."""
        return [axis.source.values for axis in self.grid if isinstance(axis.source, Levels)]

    def __len__(self) -> int:
        return math.prod(len(values) for values in self.levels) * (
            self.sample.count if self.sample else 1
        )

    def __getitem__(self, number: int) -> tuple[Any, ...]:
        """The axes' values in design `number`, counted from 0."""
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
