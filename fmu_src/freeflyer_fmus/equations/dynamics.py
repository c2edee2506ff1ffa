"""Equation (1): articulated-body forward dynamics, inverse dynamics with two velocities, H and C, energy and momentum.

All recursions run in body coordinates; wrenches and velocities go in and out in I.
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
    """(v, w) of the base and of every body, each in its own frame."""
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


def body_turns(mechanism: Mechanism, state: State) -> list[SX]:
    """w (3) of the base and of every body, each in its own frame."""
    turns = [rotation.matrix(state.orientation).T @ state.w]
    for i, joint in enumerate(mechanism.joints):
        turned = transform(joint, state.q[i])[0].T @ turns[-1]
        turns.append(turned + Z * state.qd[i] if joint.kind == "revolute" else turned)
    return turns


def without_joint(inertia: ArticulatedInertia, joint: Joint) -> ArticulatedInertia:
    """What of an articulated inertia is felt across a free joint about or along z: I - U U^T / D (Featherstone, 7.3).

    The row and column of the joint's own direction vanish; they are left out, not computed.
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
    """M~ = ((M^-1)_bb)^-1, about B in B's axes: the base's inertia with no torque in the joints (no force at the hand)."""
    inertia = mechanism.bodies[-1].articulated()
    for i in reversed(range(len(mechanism.joints))):
        joint, below = mechanism.joints[i], mechanism.bodies[i - 1] if i > 0 else mechanism.base
        inertia = below.articulated() + inertia_to_parent(
            without_joint(inertia, joint), joint, q[i]
        )
    return inertia


def articulated_end_effector_inertia(mechanism: Mechanism, state: State) -> SX:
    """((M^-1)_mm)^-1 (6, 6), at E in I: the hand's inertia with no wrench on the base and no torque in the joints."""
    inertia, turn = mechanism.base.articulated(), rotation.matrix(state.orientation)
    for i, joint in enumerate(mechanism.joints):
        inertia = (
            without_joint(inertia_to_child(inertia, joint, state.q[i]), joint)
            + mechanism.bodies[i].articulated()
        )
        turn = turn @ transform(joint, state.q[i])[0]
    hand = inertia.shifted(-sparse(mechanism.robot.end_effector_translation))
    return hand.turned(turn).matrix()


class _Pass(NamedTuple):
    """What the articulated-body algorithm's way outside in leaves for the way back."""

    transforms: list[tuple[SX, SX]]
    base_inertia: ArticulatedInertia
    base_bias: tuple[SX, SX]
    saved: list[tuple[SX, SX, SX, SX]]


def _outside_in(mechanism: Mechanism, state: State, joint_torque: SX) -> _Pass:
    """Articulated inertias and bias wrenches, tip to base (Featherstone, table 7.1).

    Accelerations are those of the bodies' origins in I, not Featherstone's spatial ones: then no linear velocity enters, as by
    Galilei none must, and the bias is w x (w x m c) and w x I w.
    """
    joints, n = mechanism.joints, len(mechanism.joints)
    transforms = [transform(joint, state.q[i]) for i, joint in enumerate(joints)]
    turns = body_turns(mechanism, state)
    inertias = [body.articulated() for body in (mechanism.base, *mechanism.bodies)]
    bias = [
        (cross(w, cross(w, body.first_moment)), cross(w, body.inertia @ w))
        for body, w in zip((mechanism.base, *mechanism.bodies), turns, strict=True)
    ]
    saved: list[tuple[SX, SX, SX, SX]] = [(SX(0), SX(0), SX(0), SX(0))] * n
    for i in reversed(range(n)):
        (M, H, I), (f, t), (R, r) = inertias[i + 1], bias[i + 1], transforms[i]
        # What the child's origin and turn accelerate by while q'' = 0 and the parent does not.
        c_v, slide = R.T @ cross(turns[i], cross(turns[i], r)), cross(turns[i + 1], Z) * state.qd[i]
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
    """q'' (n) from the acceleration of the base's origin and its angular acceleration, in its own axes."""
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
    """(1) solved for x_b'' (6, in I) and q'' (n) by the articulated-body algorithm."""
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
    """q'' (n) of the arm alone: the base moves as it is told, with x_b'' (6) and in the uniform field `gravity` (3), in I.

    The lower rows of (1). Gravity is an acceleration of the base the other way.
    """
    R_IB = rotation.matrix(state.orientation)
    done = _outside_in(mechanism, state, joint_torque)
    return _inside_out(
        mechanism, done, R_IB.T @ (base_acceleration[:3] - gravity), R_IB.T @ base_acceleration[3:]
    )


def two_velocity_inverse_dynamics(
    mechanism: Mechanism, state: State, reference_velocity: SX, reference_acceleration: SX
) -> tuple[SX, SX]:
    """H a_r + C v_r as (base part (6, in I), joint part (n)), with C at the ACTUAL velocity of `state`.

    v_r and a_r (6 + n) are a reference generalised velocity and acceleration. C is the simple one with H' - 2C skew:
    the sum over bodies of m Jv^T dJv + Jw^T (I_c dJw + [w]x I_c Jw), w the actual angular velocity. With v_r the actual
    velocity it is ordinary inverse dynamics. A recursion as in Newton-Euler, so M and Gamma are never formed.
    """
    R_IB = rotation.matrix(state.orientation)
    actual = body_turns(mechanism, state)
    w_r = R_IB.T @ reference_velocity[3:6]
    a_r, alpha_r = R_IB.T @ reference_acceleration[:3], R_IB.T @ reference_acceleration[3:6]
    y, yd = reference_velocity[6:], reference_acceleration[6:]
    wrenches = [_two_velocity_wrench(mechanism.base, actual[0], w_r, a_r, alpha_r)]
    transforms = []
    for i, joint in enumerate(mechanism.joints):
        R, r = transform(joint, state.q[i])
        transforms.append((R, r))
        w_parent, w = actual[i], actual[i + 1]
        # dr/dt in I: the offset turns with the parent; a prismatic joint also slides it (its v then is in the child's axes).
        rate = cross(w_parent, r) + (R[:, 2] * state.qd[i] if joint.kind == "prismatic" else 0)
        a_r = R.T @ (a_r + cross(alpha_r, r) + cross(w_r, rate))
        w_r, alpha_r = R.T @ w_r, R.T @ alpha_r
        if joint.kind == "revolute":
            alpha_r = alpha_r + Z * yd[i] + cross(w, Z) * y[i]
            w_r = w_r + Z * y[i]
        else:
            a_r = a_r + Z * yd[i] + cross(w, Z) * y[i]
        wrenches.append(_two_velocity_wrench(mechanism.bodies[i], w, w_r, a_r, alpha_r))
    efforts = []
    force, torque = wrenches[-1]
    for i in reversed(range(len(mechanism.joints))):
        efforts.append(torque[2] if mechanism.joints[i].kind == "revolute" else force[2])
        force, torque = wrench_to_parent(*transforms[i], force, torque)
        force, torque = force + wrenches[i][0], torque + wrenches[i][1]
    return ca.vertcat(R_IB @ force, R_IB @ torque), ca.vertcat(*reversed(efforts))


def _two_velocity_wrench(body: RigidInertia, w: SX, w_r: SX, a_r: SX, alpha_r: SX) -> tuple[SX, SX]:
    """Force and torque about the body's origin of m a_c,r and I_c alpha_r + w x I_c w_r; a_r is the origin's.

    Moved from the centre of mass c to the origin, every term in c joins the inertia about the origin but m c.c w x w_r.
    """
    mass, mc, inertia = body
    force = mass * a_r + cross(alpha_r, mc) + cross(w_r, cross(w, mc))
    torque = (
        inertia @ alpha_r + cross(mc, a_r) + cross(w, inertia @ w_r - ca.dot(mc, mc) / mass * w_r)
    )
    return force, torque


def inertia_and_coriolis(mechanism: Mechanism, state: State) -> tuple[SX, SX]:
    """H and C (6 + n, 6 + n) of (1), each read off the two-velocity recursion, which is linear in its references."""
    n = 6 + len(mechanism.joints)
    v_r, a_r = SX.sym("v_r", n), SX.sym("a_r", n)
    total = ca.vertcat(*two_velocity_inverse_dynamics(mechanism, state, v_r, a_r))
    return ca.jacobian(total, a_r), ca.jacobian(total, v_r)


def kinetic_energy(mechanism: Mechanism, state: State) -> SX:
    """Of the whole robot [J]."""
    total = SX(0)
    for body, (v, w) in zip(
        (mechanism.base, *mechanism.bodies), body_velocities(mechanism, state), strict=True
    ):
        p, L = body.momentum(v, w)
        total += 0.5 * (ca.dot(v, p) + ca.dot(w, L))
    return total


def momentum(mechanism: Mechanism, position: SX, state: State) -> tuple[SX, SX]:
    """Linear momentum [N s] and angular momentum about I's origin [N m s], both (3) in I."""
    velocities = body_velocities(mechanism, state)
    p, L = mechanism.bodies[-1].momentum(*velocities[-1])
    for i in reversed(range(len(mechanism.joints))):
        p, L = wrench_to_parent(*transform(mechanism.joints[i], state.q[i]), p, L)
        own = (mechanism.bodies[i - 1] if i > 0 else mechanism.base).momentum(*velocities[i])
        p, L = p + own[0], L + own[1]
    R_IB = rotation.matrix(state.orientation)
    p = R_IB @ p
    return p, R_IB @ L + cross(position, p)
