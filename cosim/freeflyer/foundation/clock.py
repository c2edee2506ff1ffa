"""Time as an integer number of nanoseconds.

Floating-point times would have rounding errors. Therefore only integer times are added or compared.
"""

from __future__ import annotations

from decimal import Decimal

from freeflyer.foundation.errors import ScenarioError

SECOND = 1_000_000_000


def nanoseconds(seconds: float, subject: str) -> int:
    """Convert a positive decimal number of seconds to nanoseconds without rounding.

    `subject` is the name of the time in the error message. Raises ScenarioError if the number of
    nanoseconds is not a positive whole number.
    """
    exact = Decimal(repr(float(seconds))) * SECOND if abs(seconds) < 9e9 else Decimal(0)
    if exact != int(exact) or exact <= 0:
        raise ScenarioError(
            f"{subject} is {seconds!r} s; a positive whole number of nanoseconds is expected"
        )
    return int(exact)


def seconds(time: int) -> float:
    """Convert a time [ns] to seconds, as the nearest floating-point number."""
    return time / SECOND


def shown(time: int) -> str:
    """Format a time [ns] in seconds for a message."""
    return f"{seconds(time):.9g} s"
