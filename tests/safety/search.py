"""Exhaustive search of a small world of real transition functions: breadth first, every state once, with the shortest way to a violation."""

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
    """Times relative to the present, and none older than matters [ns]; which sentence it was does not matter."""
    permit._wrote = None if permit._wrote is None else max(permit._wrote - back, oldest)
    permit._active_at = None if permit._active_at is None else max(permit._active_at - back, oldest)
    permit.lost = permit.lost and "lost"
    permit._hold_up = permit._hold_up and "held up"


def without_hold_ups(patch: pytest.MonkeyPatch) -> None:
    """Take away a guard: a hold-up does not cost the permit."""
    patch.setattr(Permit, "allows", lambda self, now: self.is_held)


MOST_STATES = 3_000_000


class World(Protocol):
    """Has everything that decides what happens next, and nothing else once `normalise` was called."""

    def moves(self) -> Iterator[tuple[str, Callable[[Any], None]]]:
        """What may happen now: a name, and what it does to a copy of this world."""

    def normalise(self) -> None:
        """Bring numbers that count on for ever within their limits, and ghosts that no longer matter to zero."""

    def violation(self) -> str | None:
        """What must never be, or None."""


@dataclass(frozen=True)
class Searched:
    states: int
    transitions: int
    violation: str | None = None
    way: tuple[str, ...] = ()
    """The moves that lead to it."""
    reached: frozenset[str] = frozenset()
    """Names of moves that were made: a search that cannot do what it claims shows here."""


PLAIN = frozenset({int, float, str, bytes, bool, type(None)})


def frozen(value: Any, ignored: frozenset[str]) -> Any:
    """A hashable picture of an object; attributes in `ignored` decide nothing."""
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
    """All states that the moves lead to. AssertionError if there are more than `most`: the world was not small."""
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
                way = [name]
                while key is not None and seen[key][1]:
                    key, before = seen[key]
                    way.append(before)
                return Searched(
                    len(seen), transitions, violated, tuple(reversed(way)), frozenset(reached)
                )
            world.normalise()
            following = frozen(world, ignored)
            if following not in seen:
                seen[following] = (key, name)
                assert len(seen) <= most, f"more than {most} states"
                waiting.append((following, pickle.dumps(world, 5)))
    return Searched(len(seen), transitions, reached=frozenset(reached))
