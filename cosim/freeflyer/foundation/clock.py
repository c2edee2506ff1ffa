"""Time as integer nanoseconds; no time is accumulated or compared in floating point."""

from __future__ import annotations

from decimal import Decimal

from freeflyer.foundation.errors import ScenarioError

SECOND = 1_000_000_000


def nanoseconds(seconds: float, subject: str) -> int:
    """Convert a positive decimal number of seconds to nanoseconds, exactly.

    `subject` names the quantity in the error message. Raises ScenarioError if the result is not a
    positive whole number.
    """
    exact = Decimal(repr(float(seconds))) * SECOND if abs(seconds) < 9e9 else Decimal(0)
    if exact != int(exact) or exact <= 0:
        raise ScenarioError(
            f"{subject} is {seconds!r} s; a positive whole number of nanoseconds is expected"
        )
    return int(exact)


def seconds(time: int) -> float:
    """Return the double nearest to `time` [ns], in seconds."""
    return time / SECOND


def shown(time: int) -> str:
    """Format a time [ns] in seconds, for messages."""
    return f"{seconds(time):.9g} s"
