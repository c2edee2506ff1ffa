"""Dynamics of the robot: equation (1) of the paper, and energy and momentum.

The module computes the forward dynamics, the matrices H and C, and an inverse dynamics with two
velocities: the actual velocity and a reference velocity.
All recursions run in body coordinates. Wrenches and velocities in arguments and results are in I,
unless a docstring states another frame.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from freeflyer_fmus.equations import rotation
from freeflyer_fmus.equations.mechanism import (
    Mechanism,
    State,
    inertia_to_child,
    inertia_to_parent,
    transform,
)
from freeflyer_fmus.equations.spatial import (
    ArticulatedInertia,
    RigidInertia,
    Z,
    cross,
    solve_positive_definite,
    sparse,
    symmetric,
    wrench_to_parent,
)
from freeflyer_fmus.robot.robot import Joint

SX = ca.SX
IN_PLANE = sparse([[1, 0, 0], [0, 1, 0], [0, 0, 0]])


def body_velocities(mechanism: Mechanism, state: State) -> list[tuple[SX, SX]]:
    """Return (v, w) of the base and of every body, each in its own frame."""
    R_IB = rotation.matrix(state.orientation)
    velocities = [(R_IB.T @ state.v, R_IB.T @ state.w)]
    for i, joint in enumerate(mechanism.joints):
        R, r = transform(joint, state.q[i])
        v, w = velocities[-1]
        v, w = R.T @ (v + cross(w, r)), R.T @ w
        if joint.kind == "revolute":
            w = w + Z * state.qd[i]
        else:
            v = v + Z * state.qd[i]
        velocities.append((v, w))
    return velocities


def body_angular_velocities(mechanism: Mechanism, state: State) -> list[SX]:
    """Return w (3) of the base and of every body, each in its own frame."""
    velocities = [rotation.matrix(state.orientation).T @ state.w]
    for i, joint in enumerate(mechanism.joints):
        w = transform(joint, state.q[i])[0].T @ velocities[-1]
        velocities.append(w + Z * state.qd[i] if joint.kind == "revolute" else w)
    return velocities


def without_joint(inertia: ArticulatedInertia, joint: Joint) -> ArticulatedInertia:
    """Return the inertia that acts on the parent through a joint without torque.

    The result is I - U U^T / D (Featherstone, 7.3). I is the articulated inertia of the child
    (6, 6). U is the column of I for the joint's direction, and D is the diagonal element in this
    column. The joint moves about or along z. In the result, the row and the column of the joint's
    direction are zero. They are structural zeros, for which no code is generated.
    """
    M, H, I = inertia
    if joint.kind == "revolute":
        h, i, D = H[:, 2], I[:, 2], I[2, 2]
    else:
        h, i, D = M[:, 2], H[2, :].T, M[2, 2]
    h_over, i_over = h / D, i / D
    M, H, I = symmetric(M - h_over @ h.T), H - h_over @ i.T, symmetric(I - i_over @ i.T)
    if joint.kind == "revolute":
        return ArticulatedInertia(M, H @ IN_PLANE, IN_PLANE @ I @ IN_PLANE)
    return ArticulatedInertia(IN_PLANE @ M @ IN_PLANE, IN_PLANE @ H, I)


def articulated_base_inertia(mechanism: Mechanism, q: SX) -> ArticulatedInertia:
    """Return M~ = ((M^-1)_bb)^-1 about B, in B's axes.

    M~ is the inertia at the base if all joint torques are zero. M is the inertia matrix of (6).
    (M^-1)_bb is the block of M^-1 for the base.
    """
    inertia = mechanism.bodies[-1].articulated()
    for i in reversed(range(len(mechanism.joints))):
        joint, below = mechanism.joints[i], mechanism.bodies[i - 1] if i > 0 else mechanism.base
        inertia = below.articulated() + inertia_to_parent(
            without_joint(inertia, joint), joint, q[i]
        )
    return inertia


def articulated_end_effector_inertia(mechanism: Mechanism, state: State) -> SX:
    """Return the end-effector inertia ((M^-1)_mm)^-1 (6, 6) at E, in I.

    This is the inertia at E if the base wrench and all joint torques are zero. M is the inertia
    matrix of (6). (M^-1)_mm is the block of M^-1 for the end-effector.
    """
    inertia, R_I = mechanism.base.articulated(), rotation.matrix(state.orientation)
    for i, joint in enumerate(mechanism.joints):
        inertia = (
            without_joint(inertia_to_child(inertia, joint, state.q[i]), joint)
            + mechanism.bodies[i].articulated()
        )
        R_I = R_I @ transform(joint, state.q[i])[0]
    at_end_effector = inertia.shifted(-sparse(mechanism.robot.end_effector_translation))
    return at_end_effector.rotated(R_I).matrix()


class _Pass(NamedTuple):
    """Results of the pass from tip to base. The pass from base to tip uses these results.

    Both passes belong to the articulated-body algorithm. `base_bias` contains the bias force and
    the bias torque of the base. `saved` contains for each joint U / D, u / D, and the linear and
    the angular acceleration of the child if q'' = 0 and the parent does not accelerate.
    `without_joint` defines U and D. u is the joint torque minus the component of the bias wrench in
    the joint's direction.
    """

    transforms: list[tuple[SX, SX]]
    base_inertia: ArticulatedInertia
    base_bias: tuple[SX, SX]
    saved: list[tuple[SX, SX, SX, SX]]


def _outside_in(mechanism: Mechanism, state: State, joint_torque: SX) -> _Pass:
    """Compute articulated inertias and bias wrenches from tip to base (Featherstone, table 7.1).

    A bias wrench is the wrench that a body needs if its accelerations are zero. The bias force of a
    rigid body is w x (w x m c). Its bias torque is w x I w.
    Featherstone uses spatial accelerations. This function uses the accelerations of the body
    origins, relative to I. These accelerations do not change if a constant velocity is added to the
    whole robot. Therefore the equations contain no linear velocity.
    """
    joints, n = mechanism.joints, len(mechanism.joints)
    transforms = [transform(joint, state.q[i]) for i, joint in enumerate(joints)]
    angular = body_angular_velocities(mechanism, state)
    inertias = [body.articulated() for body in (mechanism.base, *mechanism.bodies)]
    bias = [
        (cross(w, cross(w, body.first_moment)), cross(w, body.inertia @ w))
        for body, w in zip((mechanism.base, *mechanism.bodies), angular, strict=True)
    ]
    saved: list[tuple[SX, SX, SX, SX]] = [(SX(0), SX(0), SX(0), SX(0))] * n
    for i in reversed(range(n)):
        (M, H, I), (f, t), (R, r) = inertias[i + 1], bias[i + 1], transforms[i]
        # Linear and angular acceleration of the child if q'' = 0 and the parent does not
        # accelerate.
        c_v = R.T @ cross(angular[i], cross(angular[i], r))
        slide = cross(angular[i + 1], Z) * state.qd[i]
        if joints[i].kind == "revolute":
            U_f, U_t, D, u = H[:, 2], I[:, 2], I[2, 2], joint_torque[i] - t[2]
            c_w = slide
        else:
            U_f, U_t, D, u = M[:, 2], H[2, :].T, M[2, 2], joint_torque[i] - f[2]
            c_v, c_w = c_v + 2.0 * slide, SX(3, 1)
        free = without_joint(inertias[i + 1], joints[i])
        f = f + free.M @ c_v + free.H @ c_w + U_f * (u / D)
        t = t + free.H.T @ c_v + free.I @ c_w + U_t * (u / D)
        inertias[i] = inertias[i] + inertia_to_parent(free, joints[i], state.q[i])
        f, t = wrench_to_parent(R, r, f, t)
        bias[i] = (bias[i][0] + f, bias[i][1] + t)
        saved[i] = (ca.vertcat(U_f, U_t) / D, u / D, c_v, c_w)
    return _Pass(transforms, inertias[0], bias[0], saved)


def _inside_out(mechanism: Mechanism, done: _Pass, a: SX, alpha: SX) -> SX:
    """Return q'' (n) from the linear and angular acceleration of the base origin, in B's axes."""
    qdd = []
    for i, joint in enumerate(mechanism.joints):
        R, r = done.transforms[i]
        U_over_D, u_over_D, c_v, c_w = done.saved[i]
        a, alpha = R.T @ (a + cross(alpha, r)) + c_v, R.T @ alpha + c_w
        qdd.append(u_over_D - ca.dot(U_over_D, ca.vertcat(a, alpha)))
        if joint.kind == "revolute":
            alpha = alpha + Z * qdd[-1]
        else:
            a = a + Z * qdd[-1]
    return ca.vertcat(*qdd)


def forward_dynamics(
    mechanism: Mechanism, state: State, base_wrench: SX, joint_torque: SX
) -> tuple[SX, SX]:
    """Solve (1) for x_b'' (6, in I) and q'' (n) by the articulated-body algorithm."""
    R_IB = rotation.matrix(state.orientation)
    done = _outside_in(mechanism, state, joint_torque)
    force, torque = done.base_bias
    wrench = ca.vertcat(R_IB.T @ base_wrench[:3] - force, R_IB.T @ base_wrench[3:] - torque)
    acceleration = solve_positive_definite(done.base_inertia.matrix(), wrench)
    a, alpha = acceleration[:3], acceleration[3:]
    return ca.vertcat(R_IB @ a, R_IB @ alpha), _inside_out(mechanism, done, a, alpha)


def arm_on_moving_base(
    mechanism: Mechanism, state: State, base_acceleration: SX, joint_torque: SX, gravity: SX
) -> SX:
    """Return q'' (n) of the arm on a base with prescribed acceleration x_b'' (6), in I.

    q'' follows from the last n rows of (1), which are the rows of the joints. `gravity` (3) is the
    acceleration of a uniform gravity field, in I. Gravity has the same effect on the arm as a base
    acceleration in the opposite direction.
    """
    R_IB = rotation.matrix(state.orientation)
    done = _outside_in(mechanism, state, joint_torque)
    return _inside_out(
        mechanism, done, R_IB.T @ (base_acceleration[:3] - gravity), R_IB.T @ base_acceleration[3:]
    )


def two_velocity_inverse_dynamics(
    mechanism: Mechanism, state: State, reference_velocity: SX, reference_acceleration: SX
) -> tuple[SX, SX]:
    """Return the base part (6), in I, and the joint part (n) of H a_r + C v_r.

    v_r (6 + n) is `reference_velocity`, and a_r (6 + n) is `reference_acceleration`. Both are
    generalised: the first six elements are those of the base, the others are those of the joints.
    C is evaluated at the ACTUAL velocity in `state`. C v_r is the sum over all bodies of
    (m Jv^T dJv + Jw^T (I_c dJw + [w]x I_c Jw)) v_r. Jv is the Jacobian of the body's centre of
    mass, and Jw is the Jacobian of the body's angular velocity. dJv and dJw are their time
    derivatives. I_c is the inertia about the centre of mass. w is the actual angular velocity of
    the body. With this C, H' - 2C is skew-symmetric. If v_r is the actual velocity, the result is
    the same as in ordinary inverse dynamics. The recursion is of Newton-Euler type. Therefore it
    does not need the matrices M and Gamma of task_space.py.
    """
    R_IB = rotation.matrix(state.orientation)
    actual = body_angular_velocities(mechanism, state)
    w_r = R_IB.T @ reference_velocity[3:6]
    a_r, alpha_r = R_IB.T @ reference_acceleration[:3], R_IB.T @ reference_acceleration[3:6]
    y, yd = reference_velocity[6:], reference_acceleration[6:]
    wrenches = [_two_velocity_wrench(mechanism.base, actual[0], w_r, a_r, alpha_r)]
    transforms = []
    # Outward: compute the reference accelerations and the wrench of every body.
    for i, joint in enumerate(mechanism.joints):
        R, r = transform(joint, state.q[i])
        transforms.append((R, r))
        w_parent, w = actual[i], actual[i + 1]
        # `rate` is dr/dt relative to I, in the parent's axes. The offset r rotates with the parent.
        # A prismatic joint also changes r along the joint axis, which is the z axis of the child.
        rate = cross(w_parent, r) + (R[:, 2] * state.qd[i] if joint.kind == "prismatic" else 0)
        a_r = R.T @ (a_r + cross(alpha_r, r) + cross(w_r, rate))
        w_r, alpha_r = R.T @ w_r, R.T @ alpha_r
        if joint.kind == "revolute":
            alpha_r = alpha_r + Z * yd[i] + cross(w, Z) * y[i]
            w_r = w_r + Z * y[i]
        else:
            a_r = a_r + Z * yd[i] + cross(w, Z) * y[i]
        wrenches.append(_two_velocity_wrench(mechanism.bodies[i], w, w_r, a_r, alpha_r))
    # Inward: sum the wrenches and project them onto the joint axes.
    efforts = []
    force, torque = wrenches[-1]
    for i in reversed(range(len(mechanism.joints))):
        efforts.append(torque[2] if mechanism.joints[i].kind == "revolute" else force[2])
        force, torque = wrench_to_parent(*transforms[i], force, torque)
        force, torque = force + wrenches[i][0], torque + wrenches[i][1]
    return ca.vertcat(R_IB @ force, R_IB @ torque), ca.vertcat(*reversed(efforts))


def _two_velocity_wrench(body: RigidInertia, w: SX, w_r: SX, a_r: SX, alpha_r: SX) -> tuple[SX, SX]:
    """Return the force on a body, and the torque about the origin of the body.

    `w` is the actual angular velocity. `w_r` and `alpha_r` are the reference values of the angular
    velocity and of the angular acceleration. `a_r` is the reference acceleration of the origin.
    The force is m a_c. a_c is the reference acceleration of the centre of mass c. The torque about
    c is I_c alpha_r + w x I_c w_r. This function computes the torque about the origin instead. In
    this torque, the inertia about the origin replaces I_c, c x m a_r is added, and the term
    -m (c.c) w x w_r is added.
    """
    mass, mc, inertia = body
    force = mass * a_r + cross(alpha_r, mc) + cross(w_r, cross(w, mc))
    torque = (
        inertia @ alpha_r + cross(mc, a_r) + cross(w, inertia @ w_r - ca.dot(mc, mc) / mass * w_r)
    )
    return force, torque


def inertia_and_coriolis(mechanism: Mechanism, state: State) -> tuple[SX, SX]:
    """Return H and C (6 + n, 6 + n) of (1).

    The result of `two_velocity_inverse_dynamics` is linear in a_r and v_r. H is its Jacobian with
    respect to a_r, and C is its Jacobian with respect to v_r.
    """
    n = 6 + len(mechanism.joints)
    v_r, a_r = SX.sym("v_r", n), SX.sym("a_r", n)
    total = ca.vertcat(*two_velocity_inverse_dynamics(mechanism, state, v_r, a_r))
    return ca.jacobian(total, a_r), ca.jacobian(total, v_r)


def kinetic_energy(mechanism: Mechanism, state: State) -> SX:
    """Return the kinetic energy of the whole robot [J]."""
    total = SX(0)
    for body, (v, w) in zip(
        (mechanism.base, *mechanism.bodies), body_velocities(mechanism, state), strict=True
    ):
        p, L = body.momentum(v, w)
        total += 0.5 * (ca.dot(v, p) + ca.dot(w, L))
    return total


def momentum(mechanism: Mechanism, position: SX, state: State) -> tuple[SX, SX]:
    """Return linear momentum (3) [N s] and angular momentum (3) [N m s] about I's origin, in I."""
    velocities = body_velocities(mechanism, state)
    p, L = mechanism.bodies[-1].momentum(*velocities[-1])
    for i in reversed(range(len(mechanism.joints))):
        p, L = wrench_to_parent(*transform(mechanism.joints[i], state.q[i]), p, L)
        own = (mechanism.bodies[i - 1] if i > 0 else mechanism.base).momentum(*velocities[i])
        p, L = p + own[0], L + own[1]
    R_IB = rotation.matrix(state.orientation)
    p = R_IB @ p
    return p, R_IB @ L + cross(position, p)
