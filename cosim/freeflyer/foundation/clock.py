"""Time as integer nanoseconds: never accumulated, never compared as floating point."""

from __future__ import annotations

from decimal import Decimal

from freeflyer.foundation.errors import ScenarioError

SECOND = 1_000_000_000


def nanoseconds(seconds: float, subject: str) -> int:
    """The exact number of nanoseconds of a decimal number of seconds, which must be positive and whole."""
    exact = Decimal(repr(float(seconds))) * SECOND if abs(seconds) < 9e9 else Decimal(0)
    if exact != int(exact) or exact <= 0:
        raise ScenarioError(
            f"{subject} is {seconds!r} s; a positive whole number of nanoseconds is expected"
        )
    return int(exact)


def seconds(time: int) -> float:
    """The nearest double."""
    return time / SECOND


def shown(time: int) -> str:
    return f"{seconds(time):.9g} s"
