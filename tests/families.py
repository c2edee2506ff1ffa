"""Families of tests that take long as a whole: some members run in the default set, the others under the marker `slow`."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

import pytest


def family(members: Iterable[object], now: int | Collection[object] = 1) -> list[object]:
    """Members for one parameter; `now`: those of the default set, or how many from the first."""
    chosen = list(members)
    default = chosen[:now] if isinstance(now, int) else list(now)
    assert default
    assert all(member in chosen for member in default), (
        "a member of the default set is none of the family"
    )
    return [member if member in default else _slow(member) for member in chosen]


def _slow(member: object) -> object:
    """A tuple is one value for each of several parameters."""
    return pytest.param(*member if isinstance(member, tuple) else (member,), marks=pytest.mark.slow)


def alternating(versions: Sequence[object], names: Iterable[object]) -> list[object]:
    """Each name once, with the versions in turn: (version, name)."""
    return [(versions[k % len(versions)], name) for k, name in enumerate(names)]
