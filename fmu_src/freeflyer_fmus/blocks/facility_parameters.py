"""What the facility's blocks share: gravity, and how well its model knows it. All defaults are this project's assumptions."""

from __future__ import annotations

import casadi as ca

from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.equations.dynamics import two_velocity_inverse_dynamics
from freeflyer_fmus.equations.mechanism import Mechanism, State

SX = ca.SX


def gravity_parameters(block: Block) -> tuple[SX, SX]:
    """Gravity (3) [m/s2] in I, and the share of its joint torques that the model takes off (1: known exactly)."""
    return (
        block.parameter("gravity", [0.0, 0.0, -9.81], "m/s2", "Gravity in the laboratory, in I"),
        block.parameter(
            "gravity_model_factor", 0.99, "1", "Modelled over true gravity torque (assumed)"
        ),
    )


def gravity_model(mechanism: Mechanism, orientation: SX, q: SX, gravity: SX) -> SX:
    """Joint torques (n) that hold the arm still in the field: inverse dynamics of a base accelerated the other way."""
    rest = State(orientation, SX(3, 1), SX(3, 1), q, SX(q.numel(), 1))
    accelerated = ca.vertcat(-gravity, SX(3 + q.numel(), 1))
    _, torque = two_velocity_inverse_dynamics(mechanism, rest, SX(6 + q.numel(), 1), accelerated)
    return torque
