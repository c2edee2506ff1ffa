"""Exhaustive breadth-first search of a small model, with the shortest path to a violation.

The model uses the transition functions of the product. Every state is visited once.
"""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

import numpy as np
import pytest

from freeflyer_adapters.device.permit import Permit


def shift_permit(permit: Permit, back: int, oldest: int) -> None:
    """Make the times relative to the present [ns], limit their age, and merge all reasons."""
    permit._wrote = None if permit._wrote is None else max(permit._wrote - back, oldest)
    permit._active_at = None if permit._active_at is None else max(permit._active_at - back, oldest)
    permit.lost = permit.lost and "lost"
    permit._hold_up = permit._hold_up and "held up"


def without_hold_ups(patch: pytest.MonkeyPatch) -> None:
    """Remove a guard: a delay of the loop does not end the permit."""
    patch.setattr(Permit, "allows", lambda self, now: self.is_held)


MOST_STATES = 3_000_000


class World(Protocol):
    """Model for the search. Its attributes determine all future behaviour."""

    def moves(self) -> Iterator[tuple[str, Callable[[Any], None]]]:
        """Yield the possible moves: a name, and a function that changes a copy of this model."""

    def normalise(self) -> None:
        """Limit the range of counters, and reset values without an effect on the future."""

    def violation(self) -> str | None:
        """Return a description of the violated requirement, or None."""


@dataclass(frozen=True)
class Searched:
    """Result of a search."""

    states: int
    transitions: int
    violation: str | None = None
    path: tuple[str, ...] = ()
    """Names of the moves to the violation."""
    reached: frozenset[str] = frozenset()
    """Names of all moves that were possible; tests check them for completeness."""


PLAIN = frozenset({int, float, str, bytes, bool, type(None)})


def frozen(value: Any, ignored: frozenset[str]) -> Any:
    """Return a hashable copy of an object without the attributes in `ignored`."""
    kind = type(value)
    if kind in PLAIN or isinstance(value, Enum):
        return value
    if kind in (list, tuple, deque):
        return tuple([item if type(item) in PLAIN else frozen(item, ignored) for item in value])
    if kind is dict:
        return tuple(sorted((frozen(k, ignored), frozen(v, ignored)) for k, v in value.items()))
    if kind in (set, frozenset):
        return frozenset(frozen(item, ignored) for item in value)
    if kind is np.ndarray:
        return value.tobytes()
    return (
        kind.__name__,
        *[
            v if type(v) in PLAIN else frozen(v, ignored)
            for k, v in vars(value).items()
            if k not in ignored
        ],
    )


def explore(
    first: World, ignored: frozenset[str] = frozenset(), most: int = MOST_STATES
) -> Searched:
    """Search all reachable states until a violation. Raises AssertionError beyond `most` states."""
    first.normalise()
    seen: dict[Any, tuple[Any, str]] = {frozen(first, ignored): (None, "")}
    waiting: deque[tuple[Any, bytes]] = deque([(frozen(first, ignored), pickle.dumps(first, 5))])
    transitions = 0
    reached: set[str] = set()
    while waiting:
        key, packed = waiting.popleft()
        for name, move in pickle.loads(packed).moves():
            world = pickle.loads(packed)
            move(world)
            transitions += 1
            reached.add(name)
            if violated := world.violation():
                path = [name]
                while key is not None and seen[key][1]:
                    key, before = seen[key]
                    path.append(before)
                return Searched(
                    len(seen), transitions, violated, tuple(reversed(path)), frozenset(reached)
                )
            world.normalise()
            following = frozen(world, ignored)
            if following not in seen:
                seen[following] = (key, name)
                assert len(seen) <= most, f"more than {most} states"
                waiting.append((following, pickle.dumps(world, 5)))
    return Searched(len(seen), transitions, reached=frozenset(reached))
