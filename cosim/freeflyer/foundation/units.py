"""Units as FMI writes them ("N.m", "kg.m2", "rad/s"): conversion to a variable's unit, comparison across a connection."""

from __future__ import annotations

import re
from decimal import Decimal
from functools import lru_cache
from typing import Any

DIMENSIONLESS = "1"
LONGEST = 80
"""Characters of a unit; pint's time grows with their square."""
_POWER = r"(?:\*\*|\^)"
_EXPONENT = (
    r"\s*(?:[-+]?\d{1,2}(?:\.\d{1,3})?(?![\d.eE_])|\(\s*[-+]?\d{1,2}\s*(?:/\s*\d{1,2}\s*)?\))"
)
_ENDLESS = re.compile(
    rf"{_POWER}(?!{_EXPONENT})|{_POWER}{_EXPONENT}\s*{_POWER}|(?:\)\s*{_POWER}.*){{3}}", re.DOTALL
)
"""Powers that pint, which computes with whole numbers, could be at for ever: 9**99999999, 9**9**9, ((9**9)**9)**9."""
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789")


@lru_cache(maxsize=1)
def registry() -> Any:
    import pint  # half a second, which a run whose units are spelled alike does not need

    return pint.UnitRegistry()


@lru_cache(maxsize=256)
def unit(text: str) -> Any:
    """The unit that an FMI unit string names, whoever wrote it. Raises ValueError for one that nobody knows."""
    spelled = re.sub(r"[⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda run: f"**{run[0].translate(_SUPERSCRIPTS)}", text)
    spelled = re.sub(r"(?<=[A-Za-z])(-?\d+)", r"**\1", spelled.replace(".", "*"))
    if len(text) > LONGEST or _ENDLESS.search(spelled):
        raise ValueError(f"unit {text[:LONGEST]!r} is not known")
    try:
        return registry().parse_units("" if text == DIMENSIONLESS else spelled)
    except Exception as error:  # pint raises a dozen kinds for a malformed text
        raise ValueError(f"unit {text!r} is not known") from error


def factor(source: str, target: str) -> float:
    """What a value in `source` is multiplied by to be in `target`; ValueError where they measure different things."""
    from pint import DimensionalityError

    try:
        found = float((1.0 * unit(source)).to(unit(target)).magnitude)
    except DimensionalityError as error:
        raise ValueError(f"unit {source!r} cannot be converted to {target!r}") from error
    short = float(f"{found:.12g}")
    return (
        short if abs(short - found) <= 1e-15 * abs(found) else found
    )  # 1e-6 comes as 9.999999999999999e-07


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
