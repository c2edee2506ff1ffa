"""Units of block variables as products of SI base units, and their display units."""

from __future__ import annotations

UNITS: dict[str, dict[str, int]] = {
    "1": {},
    "1/s": {"s": -1},
    "m": {"m": 1},
    "m/rad": {"m": 1, "rad": -1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s2": {"rad": 1, "s": -2},
    "s": {"s": 1},
    "Hz": {"s": -1},
    "kg": {"kg": 1},
    "kg.m2": {"kg": 1, "m": 2},
    "kg.m/s": {"kg": 1, "m": 1, "s": -1},
    "kg.m2/s": {"kg": 1, "m": 2, "s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "N/m": {"kg": 1, "s": -2},
    "N.s/m": {"kg": 1, "s": -1},
    "N.m/rad": {"kg": 1, "m": 2, "s": -2, "rad": -1},
    "N.m.s/rad": {"kg": 1, "m": 2, "s": -1, "rad": -1},
}
DISPLAY = {"rad": ("deg", 57.29577951308232), "rad/s": ("deg/s", 57.29577951308232)}


def rate(unit: str) -> str | None:
    """Return the unit of the time derivative of a quantity in `unit`.

    Returns None if UNITS does not contain the unit of the derivative.
    """
    wanted = dict(UNITS[unit])
    wanted["s"] = wanted.get("s", 0) - 1
    wanted = {base: power for base, power in wanted.items() if power}
    return next((name for name, powers in UNITS.items() if powers == wanted), None)
