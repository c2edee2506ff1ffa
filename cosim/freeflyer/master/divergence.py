"""Limits of a run: a run whose signal exceeds a limit has diverged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from freeflyer.fmi.component import Array, Component
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import GraphError
from freeflyer.master.graph import port


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A bound on the largest absolute element of a signal, its Euclidean norm or its least element.

    The run has diverged when the bound is exceeded without a break for longer than `lasting` [ns].
    `elements` (first, last), counted from 1, selects a part of an array.
    """

    signal: str
    bound: float
    cause: str
    is_minimum: bool = False
    elements: tuple[int, int] | None = None
    euclidean: bool = False
    lasting: int = 0


def check(limit: Limit, components: Mapping[str, Component]) -> None:
    """Raise GraphError if the limit's signal is no real output or lacks the selected elements."""
    found = port(components, limit.signal, "limit")
    if found.causality != "output" or not found.real:
        raise GraphError(f"limit: {limit.signal} is not a real output")
    if limit.elements and limit.elements[1] > found.size:
        first, last = limit.elements
        raise GraphError(
            f"limit on {limit.signal}: elements {first} to {last} are watched, but it has {found.size}"
        )


class Watch:
    """The check of a limit. Call it at every instant where the limit may be or was exceeded."""

    def __init__(self, limit: Limit, signal: Array, tick: int) -> None:
        first, last = limit.elements or (1, signal.size)
        self.limit, self.view = limit, signal[first - 1 : last]
        self._square = limit.bound * limit.bound  # overflows to inf; ** would raise OverflowError
        self._patience = limit.lasting // tick
        self._passed = 0

    def __call__(self) -> str | None:
        """Return why the run has diverged, or None."""
        cause = self._below() if self.limit.is_minimum else self._above()
        if not self._patience:
            return cause
        self._passed = self._passed + 1 if cause else 0
        return (
            f"{cause}, for {seconds(self.limit.lasting):g} s"
            if self._passed > self._patience
            else None
        )

    def _above(self) -> str | None:
        # The Euclidean norm is an upper bound of the largest element, so one product decides the
        # common case. NaN fails the comparison.
        limit, view = self.limit, self.view
        if view @ view <= self._square:
            return None
        size = float(np.linalg.norm(view) if limit.euclidean else np.abs(view).max())
        if size <= limit.bound:
            return None
        return f"{limit.cause}: {limit.signal} is {size:.4g}, the limit is {limit.bound:g}"

    def _below(self) -> str | None:
        least = float(self.view.min())
        if least >= self.limit.bound:
            return None
        return f"{self.limit.cause}: {self.limit.signal} is {least:.4g}, the least allowed is {self.limit.bound:g}"
