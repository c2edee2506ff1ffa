"""Time as an integer number of nanoseconds.

Floating-point times would have rounding errors. Therefore only integer times are added or compared.
"""

from __future__ import annotations

from decimal import Decimal

from freeflyer.foundation.errors import ScenarioError

SECOND = 1_000_000_000
LONGEST = 9_000_000_000
"""Largest time [s], 285 years. A time [ns] has 64 bits."""


def nanoseconds(seconds: float, subject: str) -> int:
    """Convert a positive decimal number of seconds to nanoseconds without rounding.

    `subject` is the name of the time in the error message. Raises ScenarioError if the time exceeds
    `LONGEST`, or if the number of nanoseconds is not a positive whole number.
    """
    if not 0 < seconds <= LONGEST:
        expected = f"at most {LONGEST} s is" if seconds > 0 else "a time greater than zero is"
        raise ScenarioError(f"{subject} is {seconds!r} s; {expected} expected")
    exact = Decimal(repr(float(seconds))) * SECOND
    if exact != int(exact):
        raise ScenarioError(
            f"{subject} is {seconds!r} s; a whole number of nanoseconds is expected"
        )
    return int(exact)


def seconds(time: int) -> float:
    """Convert a time [ns] to seconds, as the nearest floating-point number."""
    return time / SECOND


def shown(time: int) -> str:
    """Format a time [ns] in seconds for a message."""
    return f"{seconds(time):.9g} s"
