"""Pose, velocity and Jacobians of the end-effector, (2) of the paper.

The module also computes the time derivative of J_m along the actual motion.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from freeflyer_fmus.equations import rotation
from freeflyer_fmus.equations.mechanism import Mechanism, State, transform
from freeflyer_fmus.equations.spatial import Z, cross, skew, sparse

SX = ca.SX


class Axes(NamedTuple):
    """Joint axes z_i, joint origins p_i and end-effector position p_e.

    `z` and `p` contain one vector (3) for each joint. All vectors are in B's axes. Positions are
    relative to B's origin.
    """

    z: list[SX]
    p: list[SX]
    p_e: SX


def axes(mechanism: Mechanism, q: SX) -> Axes:
    """Compute joint axes, joint origins and the end-effector position at q (n)."""
    R, p = SX.eye(3), SX(3, 1)
    z, origins = [], []
    for i, joint in enumerate(mechanism.joints):
        Rj, r = transform(joint, q[i])
        p = p + R @ r
        R = R @ Rj
        z.append(R[:, 2])
        origins.append(p)
    return Axes(z, origins, p + R @ sparse(mechanism.robot.end_effector_translation))


def manipulator_jacobian(mechanism: Mechanism, at: Axes) -> SX:
    """Return J_m (6, n) of (2), in B's axes."""
    columns = []
    for joint, z, p in zip(mechanism.joints, at.z, at.p, strict=True):
        if joint.kind == "revolute":
            columns.append(ca.vertcat(cross(z, at.p_e - p), z))
        else:
            columns.append(ca.vertcat(z, SX(3, 1)))
    return ca.horzcat(*columns)


def base_jacobian(p_be: SX) -> SX:
    """Return J_b (6, 6) of (2), in the axes of p_be.

    p_be (3) is the position of E relative to B's origin.
    """
    return ca.blockcat([[SX.eye(3), -skew(p_be)], [SX(3, 3), SX.eye(3)]])


def base_jacobian_transposed_times(p_be: SX, wrench: SX) -> SX:
    """Return J_b^T F (6), the wrench at B's origin that is equivalent to the wrench F at E.

    `p_be` (3) is the position of E relative to B's origin. `wrench` is F (6).
    """
    return ca.vertcat(wrench[:3], wrench[3:] + cross(p_be, wrench[:3]))


def manipulator_jacobian_rate_times(
    mechanism: Mechanism, at: Axes, v: SX, w: SX, qd: SX, y: SX
) -> SX:
    """Return dJ_m/dt y (6) for any y (n).

    J_m changes along the motion of the robot: `v` and `w` (3 each) are the linear and angular
    velocity of B, and `qd` (n) is q'. The derivative is taken relative to I, but expressed in B's
    axes, like all vectors in this function. Therefore the caller rotates the result to I and adds
    no term for the rotation of B.
    """
    # Velocities of the joint frames, from base to tip.
    v_i, w_i, p_before = v, w, SX(3, 1)
    velocities = []
    for joint, z, p, rate in zip(mechanism.joints, at.z, at.p, ca.vertsplit(qd), strict=True):
        v_i = v_i + cross(w_i, p - p_before)
        if joint.kind == "revolute":
            w_i = w_i + z * rate
        else:
            v_i = v_i + z * rate
        velocities.append((v_i, w_i))
        p_before = p
    v_e = v_i + cross(w_i, at.p_e - p_before)
    # The result is the sum over all joints: the derivative of the joint's column times its y_j.
    linear, angular = SX(3, 1), SX(3, 1)
    for joint, z, p, (v_j, w_j), y_j in zip(
        mechanism.joints, at.z, at.p, velocities, ca.vertsplit(y), strict=True
    ):
        dz = cross(w_j, z)
        if joint.kind == "revolute":
            linear += y_j * (cross(dz, at.p_e - p) + cross(z, v_e - v_j))
            angular += y_j * dz
        else:
            linear += y_j * dz
    return ca.vertcat(linear, angular)


def end_effector_orientation(mechanism: Mechanism, base_orientation: SX, q: SX) -> SX:
    """Return the quaternion (4) of E in I.

    It is computed as a product of quaternions, not from a rotation matrix. Therefore it is a smooth
    function of q.
    """
    total = base_orientation
    for i, joint in enumerate(mechanism.joints):
        total = rotation.product(total, _constant_quaternion(joint.rotation))
        if joint.kind == "revolute":
            total = rotation.product(total, rotation.about_z(q[i]))
    return rotation.product(total, _constant_quaternion(mechanism.robot.end_effector_rotation))


def _constant_quaternion(matrix: object) -> SX:
    values = Rotation.from_matrix(np.asarray(matrix)).as_quat()
    return SX(ca.DM(np.where(np.abs(values) < 1e-16, 0.0, values)))


def end_effector_pose(
    mechanism: Mechanism, base_position: SX, base_orientation: SX, q: SX
) -> tuple[SX, SX]:
    """Return position (3) [m] and quaternion (4) of E in I."""
    p = base_position + rotation.matrix(base_orientation) @ axes(mechanism, q).p_e
    return p, end_effector_orientation(mechanism, rotation.normalised(base_orientation), q)


def end_effector_velocity(mechanism: Mechanism, state: State) -> SX:
    """Return x_m' (6) of (2), in I. The velocities are computed from body to body."""
    R_IB = rotation.matrix(state.orientation)
    v, w = R_IB.T @ state.v, R_IB.T @ state.w
    chain = R_IB
    for i, joint in enumerate(mechanism.joints):
        R, r = transform(joint, state.q[i])
        v, w = R.T @ (v + cross(w, r)), R.T @ w
        if joint.kind == "revolute":
            w = w + Z * state.qd[i]
        else:
            v = v + Z * state.qd[i]
        chain = chain @ R
    r_e = sparse(mechanism.robot.end_effector_translation)
    return ca.vertcat(chain @ (v + cross(w, r_e)), chain @ w)
