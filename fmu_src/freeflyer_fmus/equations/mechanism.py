"""The robot as the recursions see it: inertias (some of them symbols) and the transform of every joint."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from freeflyer_fmus.equations.spatial import ArticulatedInertia, RigidInertia, sparse
from freeflyer_fmus.robot.robot import Joint, Robot

SX = ca.SX


class Mechanism(NamedTuple):
    """`base` and `bodies` in their own frames; the tool is part of the last body."""

    robot: Robot
    base: RigidInertia
    bodies: tuple[RigidInertia, ...]

    @property
    def joints(self) -> tuple[Joint, ...]:
        return self.robot.joints


class State(NamedTuple):
    """A configuration and its velocities: quaternion (4) of R_IB, velocities (3, 3) of B in I, q (n), q' (n)."""

    orientation: SX
    v: SX
    w: SX
    q: SX
    qd: SX


def symmetric_matrix(entries: SX) -> SX:
    """(3, 3) from [xx, yy, zz, xy, xz, yz]."""
    xx, yy, zz, xy, xz, yz = ca.vertsplit(entries)
    return ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertia_entries(matrix: object) -> list[float]:
    """[xx, yy, zz, xy, xz, yz] of a (3, 3) matrix."""
    m = np.asarray(matrix, dtype=float)
    return [float(m[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def mechanism(
    robot: Robot,
    base_mass: SX,
    base_inertia: SX,
    tool_mass: SX,
    tool_centre_of_mass: SX,
    tool_inertia: SX,
) -> Mechanism:
    """Base mass [kg] and inertia (6) about B; tool mass, centre of mass (3) in E and inertia (6) about it, in E."""
    base = RigidInertia.of(base_mass, SX(3, 1), symmetric_matrix(base_inertia))
    tool = RigidInertia.of(tool_mass, tool_centre_of_mass, symmetric_matrix(tool_inertia))
    bodies = [RigidInertia.constant(body) for body in robot.bodies]
    bodies[-1] += tool.seen_from(
        sparse(robot.end_effector_rotation), sparse(robot.end_effector_translation)
    )
    return Mechanism(robot, base + RigidInertia.constant(robot.base_attachment), tuple(bodies))


def constant_mechanism(robot: Robot) -> Mechanism:
    """With the robot's own masses as numbers."""
    return mechanism(
        robot,
        SX(robot.base.mass),
        SX(ca.DM(inertia_entries(robot.base.inertia))),
        SX(robot.tool.mass),
        SX(ca.DM(robot.tool.centre_of_mass)),
        SX(ca.DM(inertia_entries(robot.tool.inertia))),
    )


def inertia_to_parent(inertia: ArticulatedInertia, joint: Joint, q: SX) -> ArticulatedInertia:
    """About the parent's origin, in its axes: the turn about the joint's z apart, which costs less so."""
    if joint.kind == "revolute":
        inertia = inertia.rotated_about_z(ca.cos(q), ca.sin(q))
    return inertia.turned(sparse(joint.rotation)).shifted(transform(joint, q)[1])


def inertia_to_child(inertia: ArticulatedInertia, joint: Joint, q: SX) -> ArticulatedInertia:
    """The other way."""
    inertia = inertia.shifted(-transform(joint, q)[1]).turned(sparse(joint.rotation).T)
    return inertia.rotated_about_z(ca.cos(q), -ca.sin(q)) if joint.kind == "revolute" else inertia


def transform(joint: Joint, q: SX) -> tuple[SX, SX]:
    """(R, r) of the joint frame displaced by q in its parent body's frame."""
    R, r = sparse(joint.rotation), sparse(joint.translation)
    if joint.kind == "prismatic":
        return R, r + R[:, 2] * q
    c, s = ca.cos(q), ca.sin(q)
    return R @ ca.blockcat([[c, -s, SX(1, 1)], [s, c, SX(1, 1)], [SX(1, 1), SX(1, 1), SX(1)]]), r
