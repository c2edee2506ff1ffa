"""Measured results of other masters, as the Markdown tables of docs/peers.md.

Usage: python tests/peers/table.py | grep '^|'   (the peers print, too)
"""

from __future__ import annotations

from collections.abc import Mapping

import closed_loop
import numpy as np
import reference_loops
from fmpy.fmi1 import FMICallException
from masters import PEERS, arguments, before_the_instant, difference, own_master
from reference_loops import Rule
from slaves import Array

STOP = 21.0


def errors(record: Mapping[str, Array]) -> str:
    """Return the largest position errors of end-effector and base [mm]."""
    end_effector = np.linalg.norm(
        record["free_flyer.end_effector_position"] - record["reference_trajectory.position"], axis=1
    )
    base = np.linalg.norm(record["free_flyer.base_position"], axis=1)
    return f"{np.nanmax(end_effector) * 1e3:.3f} / {np.nanmax(base) * 1e3:.3f}"


def main() -> None:
    """Print the three tables."""
    print(
        "| master | FMI | base controller's step | from its rule | from ours, sequential | from ours, parallel | end-effector / base error [mm] |"
    )
    print("|---|---|---|---|---|---|---|")
    # Difference of every master from its rule and from ours.
    for base_step in (0.001, 0.3):
        for version in (2, 3):
            sequential = own_master(version, "sequential", base_step, STOP, moving=False)
            ours = [
                before_the_instant(sequential),
                own_master(version, "parallel", base_step, STOP, moving=False),
            ]
            for exchange, record in zip(("sequential", "parallel"), ours, strict=True):
                print(
                    f"| ours, {exchange} | {version} | {base_step:g} s | | | | {errors(record)} |"
                )
            options = arguments(base_step, STOP, moving=False)
            for name, peer in PEERS.items():
                if version not in peer.versions:
                    continue
                fmus = peer.fmus(version, base_step)
                record = peer.run(fmus, *options)
                away = difference(record, reference_loops.run(fmus, *options, peer.rule_for(fmus)))
                both = " | ".join(f"{difference(own, record):.1e}" for own in ours)
                print(
                    f"| {name} | {version} | {base_step:g} s | {away:.1e} | {both} | {errors(record)} |",
                    flush=True,
                )
    # The loop `robust`, with every FMU stepped at T_m.
    print()
    print("| master | FMI | from ours, same rule | end-effector / base error [mm] |")
    print("|---|---|---|---|")
    robust = {"scenario": "robust", "moving": False}
    for version in (2, 3):
        ours = {
            exchange: own_master(version, exchange, 0.001, STOP, **robust)
            for exchange in ("sequential", "parallel")
        }
        for exchange, record in ours.items():
            print(f"| ours, {exchange} | {version} | | {errors(record)} |")
        ours["sequential"] = before_the_instant(ours["sequential"])
        for name, peer in PEERS.items():
            if version in peer.versions:
                record = peer.run(peer.fmus(version, 0.001), *arguments(0.001, STOP, **robust))
                away = difference(ours[peer.exchange], record)
                print(f"| {name} | {version} | {away:.1e} | {errors(record)} |", flush=True)
    # Largest stable period for three delays of the base wrench.
    print()
    print("| T_b | without PC, same instant (sequential) | delayed by T_m | delayed by T_b |")
    print("|---|---|---|---|")
    for period in (0.02, 0.05, 0.08, 0.1, 0.12, 0.15, 0.2, 0.25, 0.3):
        cells = []
        for rule, step in (
            (Rule(sequential=True), 0.001),
            (Rule(rounds=4), 0.001),
            (Rule(rounds=4, late=True), period),
        ):
            try:
                options = arguments(step, STOP, period=period, base_passivity_control=False)
                record = reference_loops.run(closed_loop.fmus(2), *options, rule)
                cells.append(errors(record))
            except FMICallException:  # diverged beyond the validity of a block's equations
                cells.append("diverges")
        print(f"| {period:g} s | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
