"""What the observers of a run cannot see, or assume wrongly."""

from __future__ import annotations

from typing import Any

import numpy as np

from freeflyer.foundation.signal_name import component_of
from freeflyer.master.provenance import Provenance

NEEDED = ("stiffness", "damping", "period", "discretisation", "bookkeeping")


def notes(provenance: Provenance | None) -> list[str]:
    """Return a sentence for each wrong premise of an observer.

    A manipulator controller with the observer `reference` must know the law of the base controller.
    Equation (20) pairs F(k) with v(k), and not with the displacement that F(k) causes. Therefore
    the bookkeeping `as_printed` does not count the energy F^2 T^2 / (2 m) that sampling generates
    per period T on the inertia m. For a sampled spring-damper, this energy is more than the damper
    dissipates if K_P T / 2 > K_D.
    """
    found = _other_laws(provenance) if provenance else []
    for name, parameters in (provenance.parameters if provenance else {}).items():
        if "manipulator_initial_energy" not in parameters or not parameters.keys() >= set(NEEDED):
            continue
        discretisation, bookkeeping = parameters["discretisation"], parameters["bookkeeping"]
        try:
            period = float(parameters["period"])
            stiffness, damping = (
                np.array(parameters[key], dtype=float).reshape(6)
                for key in ("stiffness", "damping")
            )
        except (TypeError, ValueError, OverflowError):
            continue  # a record from elsewhere: the parameters are not those of this controller
        spring = 0.5 * period * stiffness
        too_stiff = spring > damping
        if too_stiff.any() and discretisation == "emulated" and _is_printed(bookkeeping):
            axis = int(np.argmax(too_stiff))
            found.append(
                f"The observer of port M does not see the energy that sampling generates there: {name} has the bookkeeping "
                f"{bookkeeping!r}, and K_Pm T_m / 2 = {spring[axis]:g} is above K_Dm = {damping[axis]:g} in element {axis + 1}. "
                "Set the bookkeeping `applied`, or increase the damping."
            )
    return found


SAME = {
    "base_law_stiffness": "stiffness",
    "base_law_damping": "damping",
    "position_setpoint": "position_setpoint",
    "orientation_setpoint": "orientation_setpoint",
}
"""Parameters of a manipulator controller, and of the base controller, that must be equal."""


def _other_laws(provenance: Provenance) -> list[str]:
    found = []
    for target, source in provenance.sources.items():
        base, name = component_of(target), component_of(source)
        mine, theirs = (provenance.parameters.get(key, {}) for key in (name, base))
        if mine.get("observer") != "reference" or not source.endswith(".base_damping"):
            continue
        found += [
            f"The observer `reference` of {name} assumes another law of {base}: {own} is {mine[own]}, but {base}.{other} is "
            f"{theirs[other]}. Set {name}.{own} to '={base}.{other}'."
            for own, other in SAME.items()
            if own in mine and other in theirs and mine[own] != theirs[other]
        ]
        found += [
            f"The observer `reference` of {name} needs no initial energy, but {key} is {mine[key]}: the unstable mode can use it. Set it to 0."
            for key in ("manipulator_initial_energy", "base_initial_energy")
            if np.any(np.array(mine.get(key, 0.0), dtype=float))
        ]
    return found


def _is_printed(bookkeeping: Any) -> bool:
    return bookkeeping == "as_printed" or "manipulator_as_printed" in str(bookkeeping)
