"""Rigid and articulated inertias in one frame, and how they pass from a body to its parent.

Everything is pairs of 3-vectors (linear, angular); a transform is (R, r): R turns child into parent coordinates, r is the
child's origin in the parent frame. Source of the algorithms: Featherstone, Rigid Body Dynamics Algorithms, 2008.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

from fmu_src.robot import Inertial

SX = ca.SX
Z = SX(ca.DM([0.0, 0.0, 1.0]))


def skew(v: SX) -> SX:
    """[v]x (3, 3), so that skew(v) @ u = v x u."""
    return ca.skew(v)


def cross(a: SX, b: SX) -> SX:
    return ca.cross(a, b)


def sparse(values: Any) -> SX:
    """A constant matrix with its exact zeros left out, so that products with them are never generated."""
    return SX(ca.sparsify(ca.DM(values)))


def symmetric(upper: SX) -> SX:
    """The symmetric matrix with this upper triangle: mirrored entries are the same expression, computed once."""
    return ca.triu2symm(ca.triu(upper))


class RigidInertia(NamedTuple):
    """Mass [kg], first moment m c (3) [kg m] and inertia about the frame's origin (3, 3) [kg m2]."""

    mass: SX
    first_moment: SX
    inertia: SX

    @staticmethod
    def of(mass: SX, centre_of_mass: SX, inertia: SX) -> RigidInertia:
        """From the inertia about the centre of mass."""
        shift = ca.dot(centre_of_mass, centre_of_mass) * SX.eye(3) - centre_of_mass @ centre_of_mass.T
        return RigidInertia(mass, mass * centre_of_mass, symmetric(inertia + mass * shift))

    @staticmethod
    def constant(body: Inertial) -> RigidInertia:
        whole = RigidInertia.of(SX(body.mass), SX(ca.DM(body.centre_of_mass)), SX(ca.DM(body.inertia)))
        return RigidInertia(*(ca.sparsify(part) for part in whole))

    def seen_from(self, rotation: SX, translation: SX) -> RigidInertia:
        """The same body in a frame in which this one stands at (rotation, translation)."""
        moment = rotation @ self.first_moment
        cross_term = moment @ translation.T + translation @ moment.T + self.mass * translation @ translation.T
        about = ca.trace(cross_term) * SX.eye(3) - cross_term
        turned = rotation @ self.inertia @ rotation.T
        return RigidInertia(self.mass, moment + self.mass * translation, symmetric(turned + about))

    def __add__(self, other: object) -> RigidInertia:
        assert isinstance(other, RigidInertia)
        return RigidInertia(self.mass + other.mass, self.first_moment + other.first_moment, self.inertia + other.inertia)

    def momentum(self, v: SX, w: SX) -> tuple[SX, SX]:
        """Linear momentum and angular momentum about the frame's origin, from the origin's velocity v and w."""
        return self.mass * v + cross(w, self.first_moment), self.inertia @ w + cross(self.first_moment, v)

    def articulated(self) -> ArticulatedInertia:
        return ArticulatedInertia(self.mass * SX.eye(3), -skew(self.first_moment), self.inertia)


class ArticulatedInertia(NamedTuple):
    """A symmetric 6x6 inertia in blocks: force = M a + H alpha, torque = H^T a + I alpha."""

    M: SX
    H: SX
    I: SX

    def __add__(self, other: object) -> ArticulatedInertia:
        assert isinstance(other, ArticulatedInertia)
        return ArticulatedInertia(self.M + other.M, self.H + other.H, self.I + other.I)

    def to_parent(self, R: SX, r: SX) -> ArticulatedInertia:
        """The same inertia about the parent's origin, in parent coordinates."""
        M = symmetric(R @ self.M @ R.T)
        H = R @ self.H @ R.T
        rH = skew(r) @ H
        return ArticulatedInertia(M, H - M @ skew(r), symmetric(R @ self.I @ R.T + rH + rH.T - skew(r) @ M @ skew(r)))

    def turned(self, R: SX) -> ArticulatedInertia:
        """The same inertia about the same point, in coordinates that R turns these into."""
        return ArticulatedInertia(symmetric(R @ self.M @ R.T), R @ self.H @ R.T, symmetric(R @ self.I @ R.T))

    def matrix(self) -> SX:
        return ca.blockcat([[self.M, self.H], [self.H.T, self.I]])


def wrench_to_parent(R: SX, r: SX, force: SX, torque: SX) -> tuple[SX, SX]:
    """A wrench about the child's origin, as one about the parent's, in parent coordinates."""
    turned = R @ force
    return turned, R @ torque + cross(r, turned)


def solve_positive_definite(A: SX, b: SX) -> SX:
    """A^-1 b for symmetric positive definite A by L D L^T: no pivoting needed, no square root."""
    n = A.size1()
    L, D = SX.eye(n), [SX(0)] * n
    for j in range(n):
        D[j] = A[j, j] - sum(L[j, k] ** 2 * D[k] for k in range(j))
        for i in range(j + 1, n):
            L[i, j] = (A[i, j] - sum(L[i, k] * L[j, k] * D[k] for k in range(j))) / D[j]
    x = SX(b)
    for i in range(n):
        for k in range(i):
            x[i, :] -= L[i, k] * x[k, :]
    for i in range(n):
        x[i, :] /= D[i]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            x[i, :] -= L[k, i] * x[k, :]
    return x
