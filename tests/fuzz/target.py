"""What is fuzzed, and what it may answer: a value that holds what it promises, or one of its own exceptions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random


@dataclass(frozen=True, kw_only=True)
class Target:
    """`call` takes an input and says in a word what came of it, or nothing; a promise that is broken is an AssertionError there.

    `patience` [s] is for one input. `growth` [MiB]: how far the process may grow, by all inputs together.
    """

    name: str
    generate: Callable[[Random], bytes]
    call: Callable[[bytes], str | None]
    allowed: tuple[type[Exception], ...]
    patience: float = 10.0
    growth: int = 128

    def input(self, seed: int) -> bytes:
        """The same bytes for the same seed, on every machine."""
        return self.generate(Random(f"{self.name} {seed}"))
