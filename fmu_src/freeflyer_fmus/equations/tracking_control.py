"""The control laws (7) and (8), at samples (16) and (17): feed-forward, spring and damper of both controllers."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from freeflyer_fmus.equations import rotation
from freeflyer_fmus.equations.dynamics import two_velocity_inverse_dynamics
from freeflyer_fmus.equations.kinematics import (
    axes,
    base_jacobian_transposed_times,
    manipulator_jacobian,
    manipulator_jacobian_rate_times,
)
from freeflyer_fmus.equations.mechanism import Mechanism, State
from freeflyer_fmus.equations.redundancy import (
    ConsistentInverse,
    consistent_inverse,
    reference_acceleration,
)

SX = ca.SX


class NullSpace(NamedTuple):
    """Of a redundant arm: its generalised inverse, and the share P f_q (n) of the trajectory's torque that the hand does not feel."""

    at: ConsistentInverse
    torque: SX


class FeedForward(NamedTuple):
    """F_m* = M_m x_md'' + Gamma_m x_md' and F_b* = M_bm x_md'' + Gamma_bm x_md' (6 each), in I, with what they were made of: q_r' (n),
    p_be (3) in I, a lower bound of the smallest singular value of J_m, and what is left to more than six joints.
    """

    F_m: SX
    F_b: SX
    qd_r: SX
    p_be: SX
    sigma_min: SX
    null_space: NullSpace | None


def left_inverse(J: SX) -> SX:
    """(J^T J)^-1 J^T, which is J^-1 of a square matrix, by modified Gram-Schmidt: stable down to the singularity that is refused.

    The pivots' tiny addend (1e-30 in the norm) keeps it finite at an exact singularity, so that it can be reported, with a value.
    """
    n = J.size2()
    Q, R = SX(J), SX.zeros(n, n)
    for k in range(n):
        R[k, k] = ca.sqrt(ca.sumsqr(Q[:, k]) + 1e-60)
        Q[:, k] /= R[k, k]
        for i in range(k + 1, n):
            R[k, i] = ca.dot(Q[:, k], Q[:, i])
            Q[:, i] -= R[k, i] * Q[:, k]
    X = Q.T
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            X[i, :] -= R[i, k] * X[k, :]
        X[i, :] /= R[i, i]
    return X


def smallest_singular_value(inverse_of_J: SX) -> SX:
    """A lower bound of sigma_min(J) from its (left) inverse: (sum sigma_i^-8)^(-1/8).

    Exact where one singular value is much smaller than the others, that is near a singularity (0.01 % at a ratio of three),
    and never more than 20 % too low for six of them.
    """
    inverse_square = inverse_of_J @ inverse_of_J.T
    fourth = inverse_square @ inverse_square
    return ca.sqrt(ca.sqrt(ca.sqrt(1.0 / ca.sumsqr(fourth))))


def feed_forward(
    mechanism: Mechanism, state: State, desired_velocity: SX, desired_acceleration: SX
) -> FeedForward:
    """The trajectory's share of (7) and (8), with the base's reference at rest.

    In generalised coordinates [0; x_md'] is q_r' = J_m^-1 x_md' and its derivative q_r'' = J_m^-1 (x_md'' - dJ_m q_r');
    f = H q_r'' + C q_r' (C at the ACTUAL velocity), then J~^-T of (5): F_m* = J_m^-T f_q, F_b* = f_b - J_b^T F_m*.
    With more than six joints q_r' is J# x_md' (equations/redundancy.py).
    """
    R_IB = rotation.matrix(state.orientation)
    turn = ca.diagcat(R_IB, R_IB)
    at = axes(mechanism, state.q)
    p_be = R_IB @ at.p_e
    consistent = None
    if len(mechanism.joints) == 6:
        plain = left_inverse(manipulator_jacobian(mechanism, at))
        sigma_min = smallest_singular_value(plain)
        Jm_inverse = plain @ turn.T
        qd_r = Jm_inverse @ desired_velocity
        dJm_qd_r = turn @ manipulator_jacobian_rate_times(
            mechanism, at, R_IB.T @ state.v, R_IB.T @ state.w, state.qd, qd_r
        )
        qdd_r = Jm_inverse @ (desired_acceleration - dJm_qd_r)
    else:
        consistent = consistent_inverse(mechanism, state.q)
        sigma_min = smallest_singular_value(left_inverse(consistent.Jm.T))
        Jm_inverse = consistent.inverse @ turn.T
        u, w = turn.T @ desired_velocity, R_IB.T @ state.w
        du = turn.T @ desired_acceleration - ca.vertcat(ca.cross(w, u[:3]), ca.cross(w, u[3:]))
        qd_r = consistent.inverse @ u
        qdd_r = reference_acceleration(mechanism, state, consistent, u, du)
    f_base, f_joints = two_velocity_inverse_dynamics(
        mechanism, state, ca.vertcat(SX(6, 1), qd_r), ca.vertcat(SX(6, 1), qdd_r)
    )
    F_m = Jm_inverse.T @ f_joints
    F_b = f_base - base_jacobian_transposed_times(p_be, F_m)
    null_space = (
        NullSpace(consistent, consistent.torque_in_null_space(f_joints)) if consistent else None
    )
    return FeedForward(F_m, F_b, qd_r, p_be, sigma_min, null_space)


def pose_error(position: SX, orientation: SX, desired_position: SX, desired_orientation: SX) -> SX:
    """Delta x (6) in I: position error [m] and twice the vector part of the error quaternion (rad, to third order)."""
    return ca.vertcat(position - desired_position, rotation.error(orientation, desired_orientation))


def spring_damper(stiffness: SX, damping: SX, pose_error: SX, velocity_error: SX) -> SX:
    """-K_P Delta x - K_D Delta x' (6) for diagonal gains (6 each)."""
    return -stiffness * pose_error - damping * velocity_error


def spring_energy(stiffness: SX, pose_error: SX) -> SX:
    """Potential whose gradient spring_damper's spring is, exactly for isotropic rotational stiffness: the spring part of V in (10).

    Written with Delta x as in (10) it is 1/2 Delta x^T K Delta x for the translation; for the rotation, whose Delta x is
    2 eps, that holds for small angles only: the torque -2 k eps derives from 4 k (1 - eta) = Delta x^T K Delta x / (1 + eta).
    """
    translation, turn = pose_error[:3], pose_error[3:]
    eta = ca.sqrt(ca.fmax(1.0 - 0.25 * ca.dot(turn, turn), 0.0))
    return 0.5 * ca.dot(stiffness[:3] * translation, translation) + ca.dot(
        stiffness[3:] * turn, turn
    ) / (1.0 + eta)


def joint_torque(mechanism: Mechanism, state: State, F_m: SX) -> SX:
    """tau = J_m^T F_m (n), F_m in I."""
    R_IB = rotation.matrix(state.orientation)
    return manipulator_jacobian(mechanism, axes(mechanism, state.q)).T @ (
        ca.diagcat(R_IB, R_IB).T @ F_m
    )


def null_space_torque(
    null_space: NullSpace, state: State, damping: SX, stiffness: SX, posture: SX
) -> SX:
    """P (f_q - D P^T q' - K (q - q_0)) (n) for diagonal gains: the trajectory's share, a damper, and a spring to a posture.

    The damper only takes energy; the spring, projected, has no potential, so with it V need not fall.
    """
    slow = damping * null_space.at.velocity_in_null_space(state.qd)
    return null_space.torque - null_space.at.torque_in_null_space(
        slow + stiffness * (state.q - posture)
    )
