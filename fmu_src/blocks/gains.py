"""Gains of the two control laws, with this project's defaults (the paper's text gives none)."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from fmu_src.block import Block

SX = ca.SX
STIFFNESS = ("N/m",) * 3 + ("N.m/rad",) * 3
DAMPING = ("N.s/m",) * 3 + ("N.m.s/rad",) * 3
MANIPULATOR = ([500.0] * 3 + [50.0] * 3, [80.0] * 3 + [3.0] * 3)
BASE = ([150.0] * 3 + [40.0] * 3, [10.0] * 3 + [2.0] * 3)


class Gains(NamedTuple):
    """Diagonals of K_P and K_D (6 each), in I."""

    stiffness: SX
    damping: SX


def gains(block: Block, default: tuple[list[float], list[float]], prefix: str = "") -> Gains:
    stiffness, damping = default
    return Gains(
        block.parameter(
            f"{prefix}stiffness", stiffness, STIFFNESS, "Diagonal of K_P, in I (assumed)", tunable=True, minimum=0.0
        ),
        block.parameter(f"{prefix}damping", damping, DAMPING, "Diagonal of K_D, in I (assumed)", tunable=True, minimum=0.0),
    )
