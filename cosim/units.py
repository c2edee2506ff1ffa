"""Units as FMI writes them ("N.m", "kg.m2", "rad/s"): conversion to a variable's unit, comparison across a connection."""

from __future__ import annotations

import re
from decimal import Decimal
from functools import lru_cache
from typing import Any

import pint

DIMENSIONLESS = "1"


@lru_cache(maxsize=1)
def registry() -> Any:
    return pint.UnitRegistry()


@lru_cache(maxsize=256)
def unit(text: str) -> Any:
    """The unit that an FMI unit string names. Raises ValueError for one that nobody knows."""
    spelled = re.sub(r"(?<=[A-Za-z])(-?\d+)", r"**\1", text.replace(".", "*"))
    try:
        return registry().parse_units("" if text == DIMENSIONLESS else spelled)
    except Exception as error:  # pint raises a dozen kinds for a malformed text
        raise ValueError(f"unit {text!r} is not known") from error


def factor(source: str, target: str) -> float:
    """What a value in `source` is multiplied by to be in `target`; ValueError where they measure different things."""
    try:
        found = float((1.0 * unit(source)).to(unit(target)).magnitude)
    except pint.DimensionalityError as error:
        raise ValueError(f"unit {source!r} cannot be converted to {target!r}") from error
    short = float(f"{found:.12g}")
    return short if abs(short - found) <= 1e-15 * abs(found) else found  # 1e-6 comes as 9.999999999999999e-07


def converted(value: float, by: float) -> float:
    """The product as of decimal numbers: 104 ms are 0.104 s, a whole number of nanoseconds, not 0.10400000000000001 s."""
    return float(Decimal(repr(float(value))) * Decimal(repr(float(by))))


def same(source: str | None, target: str | None) -> bool:
    """Whether a number may pass unchanged; a side that declares no unit agrees with any. Unknown units must be spelled alike."""
    if source is None or target is None or source == target:
        return True
    try:
        return abs(factor(source, target) - 1.0) < 1e-12
    except ValueError:
        return False
