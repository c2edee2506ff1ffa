"""Rigid and articulated inertias, and their transforms between the frames of child and parent.

Spatial vectors are pairs of 3-vectors (linear, angular). A transform is a pair (R, r). R maps child
coordinates to parent coordinates. r is the position of the child's origin in the parent frame. The
algorithms are from Featherstone, Rigid Body Dynamics Algorithms, 2008.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

from freeflyer_fmus.robot.robot import Inertial

SX = ca.SX
Z = SX(ca.DM([0.0, 0.0, 1.0]))


def skew(v: SX) -> SX:
    """Return the matrix [v]x (3, 3), for which skew(v) @ u = v x u."""
    return ca.skew(v)


def cross(a: SX, b: SX) -> SX:
    return ca.cross(a, b)


def sparse(values: Any) -> SX:
    """Return a constant matrix in sparse form.

    No code is generated for products with the zeros of this matrix.
    """
    return SX(ca.sparsify(ca.DM(values)))


def symmetric(upper: SX) -> SX:
    """Return the symmetric matrix with this upper triangle.

    The lower triangle has the same expressions. Therefore they are computed only once.
    """
    return ca.triu2symm(ca.triu(upper))


class RigidInertia(NamedTuple):
    """Rigid body: mass [kg], first moment m c (3) [kg m] and inertia (3, 3) [kg m2].

    The inertia is about the origin of the frame.
    """

    mass: SX
    first_moment: SX
    inertia: SX

    @staticmethod
    def of(mass: SX, centre_of_mass: SX, inertia: SX) -> RigidInertia:
        """Return the rigid inertia. `inertia` is about `centre_of_mass` (3) [m]."""
        shift = (
            ca.dot(centre_of_mass, centre_of_mass) * SX.eye(3) - centre_of_mass @ centre_of_mass.T
        )
        return RigidInertia(mass, mass * centre_of_mass, symmetric(inertia + mass * shift))

    @staticmethod
    def constant(body: Inertial) -> RigidInertia:
        whole = RigidInertia.of(
            SX(body.mass), SX(ca.DM(body.centre_of_mass)), SX(ca.DM(body.inertia))
        )
        return RigidInertia(*(ca.sparsify(part) for part in whole))

    def scaled(self, factor: SX) -> RigidInertia:
        """Return the inertia of a body of the same shape with `factor` times the density."""
        return RigidInertia(*(factor * part for part in self))

    def seen_from(self, rotation: SX, translation: SX) -> RigidInertia:
        """Return the inertia in a new frame.

        `rotation` and `translation` are the pose of the old frame in the new frame.
        """
        moment = rotation @ self.first_moment
        cross_term = (
            moment @ translation.T
            + translation @ moment.T
            + self.mass * translation @ translation.T
        )
        about = ca.trace(cross_term) * SX.eye(3) - cross_term
        rotated = rotation @ self.inertia @ rotation.T
        return RigidInertia(self.mass, moment + self.mass * translation, symmetric(rotated + about))

    def __add__(self, other: object) -> RigidInertia:
        assert isinstance(other, RigidInertia)
        return RigidInertia(
            self.mass + other.mass,
            self.first_moment + other.first_moment,
            self.inertia + other.inertia,
        )

    def momentum(self, v: SX, w: SX) -> tuple[SX, SX]:
        """Return the linear momentum, and the angular momentum about the frame's origin.

        v [m/s] is the velocity of the origin. w [rad/s] is the angular velocity.
        """
        return self.mass * v + cross(w, self.first_moment), self.inertia @ w + cross(
            self.first_moment, v
        )

    def articulated(self) -> ArticulatedInertia:
        return ArticulatedInertia(self.mass * SX.eye(3), -skew(self.first_moment), self.inertia)


class ArticulatedInertia(NamedTuple):
    """Symmetric inertia (6, 6) as the blocks M, H and I.

    a is a linear acceleration, alpha an angular acceleration. The force is M a + H alpha, and the
    torque is H^T a + I alpha.
    """

    M: SX
    H: SX
    I: SX

    def __add__(self, other: object) -> ArticulatedInertia:
        assert isinstance(other, ArticulatedInertia)
        return ArticulatedInertia(self.M + other.M, self.H + other.H, self.I + other.I)

    def rotated(self, R: SX) -> ArticulatedInertia:
        """Return the inertia in new axes with the same origin. R maps old to new coordinates."""
        return ArticulatedInertia(
            symmetric(R @ self.M @ R.T), R @ self.H @ R.T, symmetric(R @ self.I @ R.T)
        )

    def rotated_about_z(self, c: SX, s: SX) -> ArticulatedInertia:
        """Return the inertia after a rotation about z, given by its cosine c and sine s."""
        return ArticulatedInertia(*(_rotated_about_z(part, c, s) for part in self))

    def shifted(self, r: SX) -> ArticulatedInertia:
        """Return the inertia about a new origin, in the same axes.

        r points from the new origin to the old origin.
        """
        H = self.H - self.M @ skew(r)
        return ArticulatedInertia(self.M, H, symmetric(self.I + skew(r) @ H + (skew(r) @ self.H).T))

    def matrix(self) -> SX:
        return ca.blockcat([[self.M, self.H], [self.H.T, self.I]])


def _rotated_about_z(A: SX, c: SX, s: SX) -> SX:
    """Return R A R^T (3, 3) for a rotation R about z with cosine c and sine s.

    The rotation does not change the trace and the antisymmetric part of the xy block of A.
    Therefore this function needs less than half of the products that a general rotation needs.
    """
    u = s * (A[0, 0] - A[1, 1]) + c * (A[0, 1] + A[1, 0])
    column = ca.vertcat(c * A[0, 2] - s * A[1, 2], s * A[0, 2] + c * A[1, 2])
    row = ca.horzcat(c * A[2, 0] - s * A[2, 1], s * A[2, 0] + c * A[2, 1])
    in_plane = ca.blockcat([[A[0, 0] - s * u, c * u - A[1, 0]], [c * u - A[0, 1], A[1, 1] + s * u]])
    return ca.blockcat([[in_plane, column], [row, A[2, 2]]])


def wrench_to_parent(R: SX, r: SX, force: SX, torque: SX) -> tuple[SX, SX]:
    """Transform a wrench from the child frame to the parent frame.

    (R, r) is the pose of the child frame in the parent frame. The torque of the argument is about
    the child's origin. The torque of the result is about the parent's origin.
    """
    rotated = R @ force
    return rotated, R @ torque + cross(r, rotated)


def solve_positive_definite(A: SX, b: SX) -> SX:
    """Return A^-1 b for a symmetric positive definite matrix A.

    The factorisation is L D L^T, without pivoting and without square roots.
    """
    n = A.size1()
    L, D, LD = SX.eye(n), [SX(0)] * n, SX(n, n)
    for j in range(n):
        D[j] = A[j, j] - sum(L[j, k] * LD[j, k] for k in range(j))
        for i in range(j + 1, n):
            LD[i, j] = A[i, j] - sum(L[i, k] * LD[j, k] for k in range(j))
            L[i, j] = LD[i, j] / D[j]
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
