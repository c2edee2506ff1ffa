"""Redundant manipulators, with more than six joints. They are an extension of the paper.

The manipulator of the paper has six joints. The joint torques tau of a redundant manipulator are
the sum of J_m^T F_m and a null-space part P tau_0. The null-space part does not accelerate the
end-effector while the base is at rest. A split of the torques with this property is called
dynamically consistent (Khatib, IEEE J. Robotics and Automation 3(1), 1987). Dietrich, Ott and
Albu-Schaeffer compare this split with other splits (Int. J. Robotics Research 34(11), 2015). The
split uses the inertia matrix H_q of the manipulator:

    J# = H_q^-1 J_m^T L,  L = (J_m H_q^-1 J_m^T)^-1,  P = 1 - J_m^T J#^T,  tau = J_m^T F_m + P tau_0

The reference velocity of the joints is q_r' = J# x_md'. Its null-space part P^T q_r' is zero. tau_0
is the torque before the projection P. It contains the complete feed-forward torque f_q of the
trajectory. With this q_r' and this tau_0, V of (10) remains the energy of the error system. The
rate of V is (15) minus the power that the null-space damper dissipates. docs/redundant_arms.md
gives the derivation.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from freeflyer_fmus.equations.dynamics import two_velocity_inverse_dynamics
from freeflyer_fmus.equations.kinematics import axes, manipulator_jacobian
from freeflyer_fmus.equations.mechanism import Mechanism, State
from freeflyer_fmus.equations.spatial import solve_positive_definite

SX = ca.SX


class ConsistentInverse(NamedTuple):
    """J_m (6, n), H_q (n, n), L (6, 6) and J# (n, 6), for task vectors in B's axes."""

    Jm: SX
    H: SX
    Lambda: SX
    inverse: SX

    def torque_in_null_space(self, torque: SX) -> SX:
        """Return P tau (n)."""
        return torque - self.Jm.T @ (self.inverse.T @ torque)

    def velocity_in_null_space(self, velocity: SX) -> SX:
        """Return P^T q' (n)."""
        return velocity - self.inverse @ (self.Jm @ velocity)


def inertia_times(mechanism: Mechanism, q: SX, y: SX) -> SX:
    """Return H_q y (n), with the base at rest."""
    at_rest = State(SX([0, 0, 0, 1]), SX(3, 1), SX(3, 1), q, SX(q.numel(), 1))
    _, efforts = two_velocity_inverse_dynamics(
        mechanism, at_rest, SX(6 + q.numel(), 1), ca.vertcat(SX(6, 1), y)
    )
    return efforts


def consistent_inverse(mechanism: Mechanism, q: SX) -> ConsistentInverse:
    """Compute the dynamically consistent inverse at q (n)."""
    y = SX.sym("y", q.numel())
    H = ca.densify(ca.jacobian(inertia_times(mechanism, q, y), y))
    Jm = ca.densify(manipulator_jacobian(mechanism, axes(mechanism, q)))
    weighted = solve_positive_definite(H, Jm.T)
    Lambda = solve_positive_definite(Jm @ weighted, SX.eye(6))
    return ConsistentInverse(Jm, H, Lambda, weighted @ Lambda)


def reference_acceleration(
    mechanism: Mechanism, state: State, at: ConsistentInverse, u: SX, du: SX
) -> SX:
    """Return q_r'' (n), the time derivative of q_r' = J# u.

    u (6) is x_md' in B's axes. du (6) is the time derivative of the elements of u. dJ_m and dH_q
    are the time derivatives of J_m and H_q. The result is the sum of two parts. The task part
    J# (du - dJ_m q_r') is a solution of J_m q_r'' = du - dJ_m q_r'. The null-space part is
    P^T H_q^-1 (dJ_m^T L u - dH_q q_r').
    """
    q, qd, qd_r = state.q, state.qd, at.inverse @ u
    y, F = SX.sym("y", q.numel()), SX.sym("F", 6)
    Jm = manipulator_jacobian(mechanism, axes(mechanism, q))

    def along_motion(expression: SX, symbol: SX, value: SX) -> SX:
        return ca.substitute(ca.jtimes(expression, q, qd), symbol, value)

    task = at.inverse @ (du - along_motion(Jm @ y, y, qd_r))
    rest = along_motion(Jm.T @ F, F, at.Lambda @ u) - along_motion(
        inertia_times(mechanism, q, y), y, qd_r
    )
    return task + at.velocity_in_null_space(solve_positive_definite(at.H, rest))
