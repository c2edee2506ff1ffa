"""Feed-forward, spring and damper of the control laws (7) and (8).

The sampled forms of these laws are (16) and (17).
"""

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
    """Null space of a redundant manipulator.

    `at` contains J#. `torque` is the part P f_q (n) of the feed-forward torque f_q. This part acts
    in the null space. redundancy.py defines J#, P and f_q.
    """

    at: ConsistentInverse
    torque: SX


class FeedForward(NamedTuple):
    """Feed-forward wrenches F_m* = M_m x_md'' + Gamma_m x_md', F_b* = M_bm x_md'' + Gamma_bm x_md'.

    Both wrenches have six elements, in I. The other members are intermediate results: `qd_r` is
    q_r' (n), `p_be` (3) is the position of E relative to B's origin, in I, and `sigma_min` is a
    lower bound of the smallest singular value of J_m. `null_space` is None for six joints.
    """

    F_m: SX
    F_b: SX
    qd_r: SX
    p_be: SX
    sigma_min: SX
    null_space: NullSpace | None


def left_inverse(J: SX) -> SX:
    """Return (J^T J)^-1 J^T (J^-1 for a square J) by modified Gram-Schmidt.

    The algorithm is numerically stable as long as the FMU does not report a singularity. At an
    exact singularity, the norm of a column is zero. Therefore the norm is kept at 1e-30 or more.
    The result stays finite, and the FMU can report the smallest singular value.
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
    """Return (sum sigma_i^-8)^(-1/8), a lower bound of sigma_min(J).

    The argument is the inverse or the left inverse of J. sigma_i are the singular values of J. The
    bound is accurate near a singularity, where one singular value is much smaller than the others.
    If the others are three times larger, the bound is 0.01 % too low. For six singular values, the
    bound is never more than 20 % too low.
    """
    inverse_square = inverse_of_J @ inverse_of_J.T
    fourth = inverse_square @ inverse_square
    return ca.sqrt(ca.sqrt(ca.sqrt(1.0 / ca.sumsqr(fourth))))


def feed_forward(
    mechanism: Mechanism, state: State, desired_velocity: SX, desired_acceleration: SX
) -> FeedForward:
    """Compute the feed-forward of (7) and (8). The base reference is at rest.

    x_md' is `desired_velocity` (6), and x_md'' is `desired_acceleration` (6), both in I. The
    reference velocity of the joints is q_r' = J_m^-1 x_md'. Its derivative is
    q_r'' = J_m^-1 (x_md'' - dJ_m q_r'), where dJ_m is the time derivative of J_m. The feed-forward
    in generalised coordinates is f = H q_r'' + C q_r'. C is evaluated at the ACTUAL velocity. f
    consists of a base part f_b (6) and a joint part f_q (n). J~^-T of (5) transforms f into
    F_m* = J_m^-T f_q and F_b* = f_b - J_b^T F_m*. With more than six joints, J# replaces J_m^-1 in
    q_r' and F_m*, and q_r'' is computed in redundancy.py.
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
    """Return Delta x (6) in I: the position error [m], and the orientation error 2 eps.

    eps is the vector part of the error quaternion. 2 eps differs from the rotation vector [rad]
    only by terms of third order in the angle.
    """
    return ca.vertcat(position - desired_position, rotation.error(orientation, desired_orientation))


def spring_damper(stiffness: SX, damping: SX, pose_error: SX, velocity_error: SX) -> SX:
    """Return -K_P Delta x - K_D Delta x' (6) for diagonal gains (6 each)."""
    return -stiffness * pose_error - damping * velocity_error


def spring_energies(stiffness: SX, pose_error: SX) -> SX:
    """Return 1/2 K_P Delta x^2 (6), the energy of each spring of `spring_damper`.

    For rotation this is the potential up to the fourth power of the angle: 7 % less at 60 deg.
    """
    return 0.5 * stiffness * pose_error**2


def spring_energy(stiffness: SX, pose_error: SX) -> SX:
    """Return the potential energy of the spring in `spring_damper`. It is a part of V of (10).

    The energy is exact if the rotational stiffness is isotropic. The translational part is
    1/2 Delta x^T K Delta x, as in (10). The rotational part differs from (10), because (10) is
    valid for small angles only. The rotational part of Delta x is 2 eps. For a rotational stiffness
    k, the torque -2 k eps has the potential 4 k (1 - eta) = Delta x^T K Delta x / (1 + eta). eta is
    the scalar part of the error quaternion.
    """
    translation, rotational = pose_error[:3], pose_error[3:]
    eta = ca.sqrt(ca.fmax(1.0 - 0.25 * ca.dot(rotational, rotational), 0.0))
    return 0.5 * ca.dot(stiffness[:3] * translation, translation) + ca.dot(
        stiffness[3:] * rotational, rotational
    ) / (1.0 + eta)


def joint_torque(mechanism: Mechanism, state: State, F_m: SX) -> SX:
    """Return tau = J_m^T F_m (n). F_m is in I."""
    R_IB = rotation.matrix(state.orientation)
    return manipulator_jacobian(mechanism, axes(mechanism, state.q)).T @ (
        ca.diagcat(R_IB, R_IB).T @ F_m
    )


def null_space_torque(
    null_space: NullSpace, state: State, damping: SX, stiffness: SX, posture: SX
) -> SX:
    """Return P (f_q - D P^T q' - K (q - q_0)) (n) for diagonal gains D and K.

    f_q is the feed-forward torque of the trajectory. D is `damping`, the gain of a damper. K is
    `stiffness`, the gain of a spring that pulls the joints to q_0 (`posture`). P projects the
    torques into the null space. The damper only dissipates energy. The spring has no potential
    energy after the projection. Therefore V of (10) can increase if K is not zero.
    """
    slow = damping * null_space.at.velocity_in_null_space(state.qd)
    return null_space.torque - null_space.at.torque_in_null_space(
        slow + stiffness * (state.q - posture)
    )
