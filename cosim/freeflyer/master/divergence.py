"""Limits of signals. A run has diverged if a signal exceeds its limit.

The limits of the shipped scenarios are in `[[limits]]` of paper/scenarios/_free_flyer_loop.toml. A
run also has diverged if a step fails with `StepFailed.left_validity` (foundation/errors.py).
"""

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
    """A bound for a signal.

    By default, `bound` is an upper bound for the largest absolute value of the elements. If
    `euclidean` is True, `bound` is an upper bound for the Euclidean norm. If `is_minimum` is True,
    `bound` is a lower bound for the smallest element.

    The run has diverged if the signal violates the bound without interruption for longer than
    `lasting` [ns]. If `lasting` is 0, one violation is sufficient. `elements` selects a part of an
    array: it contains the numbers of the first and of the last element, counted from 1. `cause` is
    the first part of the message.
    """

    signal: str
    bound: float
    cause: str
    is_minimum: bool = False
    elements: tuple[int, int] | None = None
    euclidean: bool = False
    lasting: int = 0


def check(limit: Limit, components: Mapping[str, Component]) -> None:
    """Check the signal of a limit.

    Raises GraphError if the signal is not a real output, or if a selected element does not exist.
    """
    found = port(components, limit.signal, "limit")
    if found.causality != "output" or not found.real:
        raise GraphError(f"limit: {limit.signal} is not a real output")
    if limit.elements and limit.elements[1] > found.size:
        first, last = limit.elements
        raise GraphError(
            f"limit on {limit.signal}: elements {first} to {last} are watched, but the signal has {found.size} elements"
        )


class Watch:
    """The check of one limit. `signal` is a view of the signal's present value.

    Call the object at each instant at which the limit may be exceeded. When the limit is
    no longer exceeded, call the object once more. This call resets the count of instants for
    `lasting`. At all other instants, the call can be omitted.
    """

    def __init__(self, limit: Limit, signal: Array, tick: int) -> None:
        first, last = limit.elements or (1, signal.size)
        self.limit, self.view = limit, signal[first - 1 : last]
        self._square = limit.bound * limit.bound  # may become inf; ** would raise OverflowError
        self._patience = limit.lasting // tick
        self._passed = 0

    def __call__(self) -> str | None:
        """Return the message if the run has diverged, otherwise None."""
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
        # The largest absolute element is never larger than the Euclidean norm. Therefore, if the
        # norm is within the bound, the limit is not exceeded, with or without `euclidean`. If an
        # element is NaN, both comparisons with `<=` are false, and the limit counts as exceeded.
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
        return f"{self.limit.cause}: {self.limit.signal} is {least:.4g}, the smallest allowed value is {self.limit.bound:g}"
