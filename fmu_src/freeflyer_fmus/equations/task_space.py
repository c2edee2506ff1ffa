"""Dynamics in the task velocities [x_b'; x_m'] instead of [x_b'; q'], (3)-(6) of the paper.

Tests and analysis use M and Gamma of (6). The controllers do not need these matrices (see
tracking_control.py).
"""

from __future__ import annotations

import casadi as ca

from freeflyer_fmus.equations import rotation
from freeflyer_fmus.equations.dynamics import inertia_and_coriolis
from freeflyer_fmus.equations.kinematics import axes, base_jacobian, manipulator_jacobian
from freeflyer_fmus.equations.mechanism import Mechanism, State

SX = ca.SX


def jacobians(mechanism: Mechanism, state: State) -> tuple[SX, SX]:
    """Return J_b (6, 6) and J_m (6, n) of equation (2) of the paper, in the inertial frame I."""
    R_IB = rotation.matrix(state.orientation)
    at = axes(mechanism, state.q)
    R = ca.diagcat(R_IB, R_IB)
    return base_jacobian(R_IB @ at.p_e), R @ manipulator_jacobian(mechanism, at)


def task_jacobian(Jb: SX, Jm: SX) -> SX:
    """Return J~ (12, 12) of (4), for a manipulator with six joints."""
    return ca.blockcat([[SX.eye(6), SX(6, Jm.size2())], [Jb, Jm]])


def rate(mechanism: Mechanism, expression: SX, state: State) -> SX:
    """Return the time derivative of `expression` along the actual motion.

    `expression` depends on the joint positions and on the base orientation, but not on the base
    position.
    """
    along_q = ca.jtimes(expression, state.q, state.qd)
    return along_q + ca.jtimes(
        expression, state.orientation, rotation.derivative(state.orientation, state.w)
    )


def inertia_and_coriolis_in_task_space(mechanism: Mechanism, state: State) -> tuple[SX, SX]:
    """Return M and Gamma (12, 12) of (6), for a square J_m.

    M = J~^-T H J~^-1, Gamma = J~^-T (C - H J~^-1 dJ~/dt) J~^-1.
    """
    H, C = inertia_and_coriolis(mechanism, state)
    J = task_jacobian(*jacobians(mechanism, state))
    J_inverse = ca.inv(J)
    M = J_inverse.T @ H @ J_inverse
    Gamma = J_inverse.T @ (C - H @ J_inverse @ rate(mechanism, J, state)) @ J_inverse
    return M, Gamma
