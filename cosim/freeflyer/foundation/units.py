"""Conversion and comparison of units in FMI notation, such as "N.m", "kg.m2" and "rad/s"."""

from __future__ import annotations

import re
from decimal import Decimal
from functools import lru_cache
from typing import Any

DIMENSIONLESS = "1"
WRENCH = ("N",) * 3 + ("N.m",) * 3
TWIST = ("m/s",) * 3 + ("rad/s",) * 3
ACCELERATION = ("m/s2",) * 3 + ("rad/s2",) * 3
LONGEST = 80
"""Largest allowed number of characters of a unit.

The time that pint needs to parse a unit is quadratic in this number.
"""
_POWER = r"(?:\*\*|\^)"
_EXPONENT = (
    r"\s*(?:[-+]?\d{1,2}(?:\.\d{1,3})?(?![\d.eE_])|\(\s*[-+]?\d{1,2}\s*(?:/\s*\d{1,2}\s*)?\))"
)
_ENDLESS = re.compile(
    rf"{_POWER}(?!{_EXPONENT})|{_POWER}{_EXPONENT}\s*{_POWER}|(?:\)\s*{_POWER}.*){{3}}", re.DOTALL
)
"""Matches texts with powers such as 9**99999999 and 9**9**9. Such texts are rejected.

pint would compute the power as an exact integer, and this computation would practically never end.
"""
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789")


@lru_cache(maxsize=1)
def registry() -> Any:
    # This import takes 0.5 s. Many runs do not need pint, because two units with the same spelling
    # are compared without pint. Therefore the import is not at the top of the file.
    import pint

    return pint.UnitRegistry()


@lru_cache(maxsize=256)
def unit(text: str) -> Any:
    """Parse an untrusted FMI unit string into a pint unit.

    Raises ValueError if the unit is unknown.
    """
    spelled = re.sub(r"[⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda run: f"**{run[0].translate(_SUPERSCRIPTS)}", text)
    spelled = re.sub(r"(?<=[A-Za-z])(-?\d+)", r"**\1", spelled.replace(".", "*"))
    if len(text) > LONGEST or _ENDLESS.search(spelled):
        raise ValueError(f"unit {text[:LONGEST]!r} is not known")
    try:
        return registry().parse_units("" if text == DIMENSIONLESS else spelled)
    except Exception as error:  # pint raises many exception types for a malformed text
        raise ValueError(f"unit {text!r} is not known") from error


def factor(source: str, target: str) -> float:
    """Return the factor that converts a value from the unit `source` to the unit `target`.

    Raises ValueError if a unit is unknown or the dimensions differ.
    """
    from pint import DimensionalityError

    try:
        found = float((1.0 * unit(source)).to(unit(target)).magnitude)
    except DimensionalityError as error:
        raise ValueError(f"unit {source!r} cannot be converted to {target!r}") from error
    # Remove rounding errors: pint computes 9.999999999999999e-07 for the factor 1e-6.
    short = float(f"{found:.12g}")
    return short if abs(short - found) <= 1e-15 * abs(found) else found


def converted(value: float, by: float) -> float:
    """Multiply two numbers in decimal arithmetic.

    `value` is a value in one unit, and `by` is the result of `factor`. Decimal arithmetic converts
    104 ms to 0.104 s. Floating-point arithmetic would result in 0.10400000000000001 s.
    """
    return float(Decimal(repr(float(value))) * Decimal(repr(float(by))))


def quantity(text: str) -> dict[str, Any] | None:
    """Return `value` and `unit` of a text such as "300 ms". Return None for any other text."""
    number, _, name = text.strip().partition(" ")
    try:
        return {"value": float(number), "unit": name.strip()} if name else None
    except ValueError:
        return None


def in_unit(value: Any, target: str) -> Any:
    """Return a value with a unit as a number in the unit `target`, and any other value unchanged.

    A value with a unit is a text such as "300 ms", or a table with the keys `value` and `unit`. The
    value in the table is a number or a list of numbers. Raises ValueError if the unit is unknown or
    cannot be converted, or if a number is too large.
    """
    if isinstance(value, str):
        value = quantity(value) or value
    if not (is_quantity(value) and isinstance(value["unit"], str)):
        return value
    many = isinstance(value["value"], list)
    numbers = value["value"] if many else [value["value"]]
    if not all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers):
        return value
    by = factor(value["unit"], target)
    try:
        found = [converted(number, by) for number in numbers]
    except OverflowError as error:
        raise ValueError("the number is too large") from error
    return found if many else found[0]


def is_quantity(value: object) -> bool:
    """Return whether a value is a table with the keys `value` and `unit`."""
    return isinstance(value, dict) and value.keys() == {"value", "unit"}


def same(source: str | None, target: str | None) -> bool:
    """Return whether a value needs no conversion from the unit `source` to the unit `target`.

    None means that no unit is declared. If one of the units is None, the result is True. If one of
    the units is unknown, the result is True only if both units have exactly the same spelling.
    """
    if source is None or target is None or source == target:
        return True
    try:
        return abs(factor(source, target) - 1.0) < 1e-12
    except ValueError:
        return False
