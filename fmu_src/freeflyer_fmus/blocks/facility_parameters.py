"""Gravity and the gravity model in the facility's blocks. All defaults are assumptions."""

from __future__ import annotations

import casadi as ca

from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.equations.dynamics import two_velocity_inverse_dynamics
from freeflyer_fmus.equations.mechanism import Mechanism, State

SX = ca.SX


def gravity_parameters(block: Block) -> tuple[SX, SX]:
    """Declare gravity (3) [m/s2] in I, and the ratio of the modelled to the true gravity torque."""
    return (
        block.parameter("gravity", [0.0, 0.0, -9.81], "m/s2", "Gravity in the laboratory, in I"),
        block.parameter(
            "gravity_model_factor",
            0.99,
            "1",
            "Ratio of the modelled to the true gravity torque (assumed)",
        ),
    )


def gravity_model(mechanism: Mechanism, orientation: SX, q: SX, gravity: SX) -> SX:
    """Return the joint torques (n) that hold the arm at rest under gravity.

    `orientation` is the quaternion of the base. `gravity` (3) is in I. Gravity needs the same
    torques as a base acceleration of -`gravity`. Therefore the torques are computed by inverse
    dynamics with this base acceleration.
    """
    rest = State(orientation, SX(3, 1), SX(3, 1), q, SX(q.numel(), 1))
    accelerated = ca.vertcat(-gravity, SX(3 + q.numel(), 1))
    _, torque = two_velocity_inverse_dynamics(mechanism, rest, SX(6 + q.numel(), 1), accelerated)
    return torque
