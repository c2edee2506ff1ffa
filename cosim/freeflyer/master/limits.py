"""Limits of a run: what is watched at every instant, and when it counts as diverged."""

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
    """The run has diverged once the signal's largest element (or its Euclidean norm) is above a maximum, or its least below a
    minimum, without a break for longer than `lasting` [ns]. `elements` (first, last), counted from 1, picks a part of an array.
    """

    signal: str
    bound: float
    cause: str
    is_minimum: bool = False
    elements: tuple[int, int] | None = None
    euclidean: bool = False
    lasting: int = 0


def check(limit: Limit, components: Mapping[str, Component]) -> None:
    """Raises GraphError for a limit on something that is no real output, or on elements that are not there."""
    found = port(components, limit.signal, "limit")
    if found.causality != "output" or not found.real:
        raise GraphError(f"limit: {limit.signal} is not a real output")
    if limit.elements and limit.elements[1] > found.size:
        first, last = limit.elements
        raise GraphError(
            f"limit on {limit.signal}: elements {first} to {last} are watched, but it has {found.size}"
        )


class Watch:
    """A limit on the present value of its signal. Call it once an instant, whenever the limit may be passed or was."""

    def __init__(self, limit: Limit, signal: Array, tick: int) -> None:
        first, last = limit.elements or (1, signal.size)
        self.limit, self.view = limit, signal[first - 1 : last]
        self._square = (
            limit.bound * limit.bound
        )  # infinite, where a power would be an OverflowError
        self._patience = limit.lasting // tick
        self._passed = 0

    def __call__(self) -> str | None:
        """Why the run has diverged, or None."""
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
        # The Euclidean norm bounds the largest element: one product decides the common case; NaN fails it.
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
