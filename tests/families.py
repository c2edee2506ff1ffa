"""Families of slow tests: some members run by default, the others have the marker `slow`."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

import pytest


def family(members: Iterable[object], now: int | Collection[object] = 1) -> list[object]:
    """Return parameter values; `now` are those of the default set, or how many from the first."""
    chosen = list(members)
    default = chosen[:now] if isinstance(now, int) else list(now)
    assert default
    assert all(member in chosen for member in default), (
        "a member of the default set is not in the family"
    )
    return [member if member in default else _slow(member) for member in chosen]


def _slow(member: object) -> object:
    """Mark a member as slow; a tuple contains one value for each of several parameters."""
    return pytest.param(*member if isinstance(member, tuple) else (member,), marks=pytest.mark.slow)


def alternating(versions: Sequence[object], names: Iterable[object]) -> list[object]:
    """Return (version, name) for each name once, with alternating versions."""
    return [(versions[k % len(versions)], name) for k, name in enumerate(names)]
