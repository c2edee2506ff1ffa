"""Fuzzing target: a function that returns a valid value or raises a documented exception."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random


@dataclass(frozen=True, kw_only=True)
class Target:
    """A fuzzing target.

    `call` processes an input and returns the name of the outcome, or None. It raises
    AssertionError for an invalid value. `time_limit`: longest time for one input [s]. `growth`:
    largest growth of the process over all inputs [MiB].
    """

    name: str
    generate: Callable[[Random], bytes]
    call: Callable[[bytes], str | None]
    allowed: tuple[type[Exception], ...]
    time_limit: float = 10.0
    growth: int = 128

    def input(self, seed: int) -> bytes:
        """Return the input of a seed; it is the same on every machine."""
        return self.generate(Random(f"{self.name} {seed}"))
