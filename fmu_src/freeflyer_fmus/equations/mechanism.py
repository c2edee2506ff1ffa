"""Robot model for the other modules of `equations`: inertias and joint transforms.

The inertias of base and tool may be symbols.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from freeflyer_fmus.equations.spatial import ArticulatedInertia, RigidInertia, sparse
from freeflyer_fmus.robot.robot import Joint, Robot

SX = ca.SX


class Mechanism(NamedTuple):
    """Robot with its inertias.

    `base` is the inertia of the base in the base frame B, with everything that is fixed to the
    base. `bodies[i]` is the inertia of the body after joint i, in joint frame i. The last body
    includes the tool.
    """

    robot: Robot
    base: RigidInertia
    bodies: tuple[RigidInertia, ...]

    @property
    def joints(self) -> tuple[Joint, ...]:
        return self.robot.joints


class State(NamedTuple):
    """Configuration and velocities of the robot.

    `orientation`: quaternion (4) of R_IB. `v` [m/s], `w` [rad/s]: velocities (3) of B in I.
    `q`, `qd` (n): joint positions and velocities.
    """

    orientation: SX
    v: SX
    w: SX
    q: SX
    qd: SX


def symmetric_matrix(entries: SX) -> SX:
    """Return the matrix (3, 3) with the entries [xx, yy, zz, xy, xz, yz]."""
    xx, yy, zz, xy, xz, yz = ca.vertsplit(entries)
    return ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertia_entries(matrix: object) -> list[float]:
    """Return [xx, yy, zz, xy, xz, yz] of a matrix (3, 3)."""
    m = np.asarray(matrix, dtype=float)
    return [float(m[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def mechanism(
    robot: Robot,
    base_mass: SX,
    base_inertia: SX,
    tool_mass: SX,
    tool_centre_of_mass: SX,
    tool_inertia: SX,
    arm_factor: SX,
) -> Mechanism:
    """Return the mechanism with these inertias of base and tool.

    The inertias of all other bodies are the constants in `robot`, multiplied by `arm_factor`.
    Masses are in kg. `base_inertia` and `tool_inertia` are [xx, yy, zz, xy, xz, yz] in kg m2, about
    the centre of mass. The axes are those of B for the base and those of E for the tool.
    `tool_centre_of_mass` (3) [m] is in E.
    """
    base = RigidInertia.of(base_mass, SX(3, 1), symmetric_matrix(base_inertia))
    tool = RigidInertia.of(tool_mass, tool_centre_of_mass, symmetric_matrix(tool_inertia))
    bodies = [RigidInertia.constant(body).scaled(arm_factor) for body in robot.bodies]
    bodies[-1] += tool.seen_from(
        sparse(robot.end_effector_rotation), sparse(robot.end_effector_translation)
    )
    attachment = RigidInertia.constant(robot.base_attachment).scaled(arm_factor)
    return Mechanism(robot, base + attachment, tuple(bodies))


def constant_mechanism(robot: Robot) -> Mechanism:
    """Return the mechanism with all masses and inertias of `robot` as numbers."""
    return mechanism(
        robot,
        SX(robot.base.mass),
        SX(ca.DM(inertia_entries(robot.base.inertia))),
        SX(robot.tool.mass),
        SX(ca.DM(robot.tool.centre_of_mass)),
        SX(ca.DM(inertia_entries(robot.tool.inertia))),
        SX(1),
    )


def inertia_to_parent(inertia: ArticulatedInertia, joint: Joint, q: SX) -> ArticulatedInertia:
    """Transform an inertia from the frame of the child to the frame of the parent.

    The result is about the parent's origin, in the parent's axes. For a revolute joint, the
    rotation about z by q and the constant rotation of the joint are two steps. Together they need
    fewer operations than one general rotation.
    """
    if joint.kind == "revolute":
        inertia = inertia.rotated_about_z(ca.cos(q), ca.sin(q))
    return inertia.rotated(sparse(joint.rotation)).shifted(transform(joint, q)[1])


def inertia_to_child(inertia: ArticulatedInertia, joint: Joint, q: SX) -> ArticulatedInertia:
    """Transform an inertia from the frame of the parent to the frame of the child.

    The function is the inverse of `inertia_to_parent`.
    """
    inertia = inertia.shifted(-transform(joint, q)[1]).rotated(sparse(joint.rotation).T)
    return inertia.rotated_about_z(ca.cos(q), -ca.sin(q)) if joint.kind == "revolute" else inertia


def transform(joint: Joint, q: SX) -> tuple[SX, SX]:
    """Return the pose (R, r) of the joint frame in the frame of the parent body.

    q is the displacement of the joint [rad] or [m].
    """
    R, r = sparse(joint.rotation), sparse(joint.translation)
    if joint.kind == "prismatic":
        return R, r + R[:, 2] * q
    c, s = ca.cos(q), ca.sin(q)
    return R @ ca.blockcat([[c, -s, SX(1, 1)], [s, c, SX(1, 1)], [SX(1, 1), SX(1, 1), SX(1)]]), r
