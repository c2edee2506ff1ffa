"""Control laws (7) and (8), sampled (16) and (17): feed-forward, spring and damper of each."""

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
    """Null space of a redundant manipulator: J# and the feed-forward torque in it, P f_q (n)."""

    at: ConsistentInverse
    torque: SX


class FeedForward(NamedTuple):
    """Feed-forward wrenches F_m* = M_m x_md'' + Gamma_m x_md', F_b* = M_bm x_md'' + Gamma_bm x_md'.

    Both (6), in I. Intermediate results: q_r' (n), p_be (3) in I, and a lower bound of the smallest
    singular value of J_m. `null_space` is None for six joints.
    """

    F_m: SX
    F_b: SX
    qd_r: SX
    p_be: SX
    sigma_min: SX
    null_space: NullSpace | None


def left_inverse(J: SX) -> SX:
    """Return (J^T J)^-1 J^T (J^-1 for a square J) by modified Gram-Schmidt.

    It is stable up to the singularity threshold. The small addend in the norm (1e-30) keeps the
    result finite at an exact singularity, so that the singularity can be reported with its value.
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
    """Return a lower bound of sigma_min(J) from its (left) inverse: (sum sigma_i^-8)^(-1/8).

    The bound is tight near a singularity, where one singular value is much smaller than the others
    (0.01 % at a ratio of three). For six singular values it is never more than 20 % too low.
    """
    inverse_square = inverse_of_J @ inverse_of_J.T
    fourth = inverse_square @ inverse_square
    return ca.sqrt(ca.sqrt(ca.sqrt(1.0 / ca.sumsqr(fourth))))


def feed_forward(
    mechanism: Mechanism, state: State, desired_velocity: SX, desired_acceleration: SX
) -> FeedForward:
    """Compute the feed-forward of (7) and (8), with the base reference at rest.

    In generalised coordinates, [0; x_md'] is q_r' = J_m^-1 x_md', with derivative
    q_r'' = J_m^-1 (x_md'' - dJ_m q_r'). Then f = H q_r'' + C q_r', with C at the ACTUAL velocity.
    J~^-T of (5) gives F_m* = J_m^-T f_q and F_b* = f_b - J_b^T F_m*.
    With more than six joints, q_r' = J# x_md' (equations/redundancy.py).
    """
    R_IB = rotation.matrix(state.orientation)
    R = ca.diagcat(R_IB, R_IB)
    at = axes(mechanism, state.q)
    p_be = R_IB @ at.p_e
    consistent = None
    if len(mechanism.joints) == 6:
        plain = left_inverse(manipulator_jacobian(mechanism, at))
        sigma_min = smallest_singular_value(plain)
        Jm_inverse = plain @ R.T
        qd_r = Jm_inverse @ desired_velocity
        dJm_qd_r = R @ manipulator_jacobian_rate_times(
            mechanism, at, R_IB.T @ state.v, R_IB.T @ state.w, state.qd, qd_r
        )
        qdd_r = Jm_inverse @ (desired_acceleration - dJm_qd_r)
    else:
        consistent = consistent_inverse(mechanism, state.q)
        sigma_min = smallest_singular_value(left_inverse(consistent.Jm.T))
        Jm_inverse = consistent.inverse @ R.T
        u, w = R.T @ desired_velocity, R_IB.T @ state.w
        du = R.T @ desired_acceleration - ca.vertcat(ca.cross(w, u[:3]), ca.cross(w, u[3:]))
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
    """Return Delta x (6) in I: position error [m] and 2 eps of the error quaternion.

    2 eps equals the rotation vector [rad] to third order.
    """
    return ca.vertcat(position - desired_position, rotation.error(orientation, desired_orientation))


def spring_damper(stiffness: SX, damping: SX, pose_error: SX, velocity_error: SX) -> SX:
    """Return -K_P Delta x - K_D Delta x' (6) for diagonal gains (6 each)."""
    return -stiffness * pose_error - damping * velocity_error


def spring_energy(stiffness: SX, pose_error: SX) -> SX:
    """Return the spring energy in V of (10), the potential of the spring of `spring_damper`.

    It is exact for isotropic rotational stiffness. The translational part is as in (10),
    1/2 Delta x^T K Delta x. For the rotation, Delta x = 2 eps and (10) holds for small angles only:
    the potential of the torque -2 k eps is 4 k (1 - eta) = Delta x^T K Delta x / (1 + eta).
    """
    translation, rotational = pose_error[:3], pose_error[3:]
    eta = ca.sqrt(ca.fmax(1.0 - 0.25 * ca.dot(rotational, rotational), 0.0))
    return 0.5 * ca.dot(stiffness[:3] * translation, translation) + ca.dot(
        stiffness[3:] * rotational, rotational
    ) / (1.0 + eta)


def joint_torque(mechanism: Mechanism, state: State, F_m: SX) -> SX:
    """Return tau = J_m^T F_m (n), with F_m in I."""
    R_IB = rotation.matrix(state.orientation)
    return manipulator_jacobian(mechanism, axes(mechanism, state.q)).T @ (
        ca.diagcat(R_IB, R_IB).T @ F_m
    )


def null_space_torque(
    null_space: NullSpace, state: State, damping: SX, stiffness: SX, posture: SX
) -> SX:
    """Return P (f_q - D P^T q' - K (q - q_0)) (n) for diagonal gains D and K.

    The terms are the trajectory's torque, a damper, and a spring to a posture. The damper only
    dissipates energy. The projected spring has no potential, so with it V may increase.
    """
    slow = damping * null_space.at.velocity_in_null_space(state.qd)
    return null_space.torque - null_space.at.torque_in_null_space(
        slow + stiffness * (state.q - posture)
    )
