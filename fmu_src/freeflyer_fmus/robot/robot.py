"""Numerical robot model: a rigid base and a serial chain of joints with one degree of freedom.

The conventions are in NOTATION.md. The origin of the base frame B is the centre of mass of the base
body. The axes of B are the axes of the base link. The z axis of every joint frame is the joint
axis: a revolute joint rotates about z, and a prismatic joint moves along z. This convention
simplifies the recursions of the dynamics.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from freeflyer_fmus.errors import RobotError
from freeflyer_fmus.robot.visual import Appearance

Array = NDArray[np.float64]


def constant(values: object, shape: tuple[int, ...]) -> Array:
    """Return a read-only float array of the given shape."""
    array = np.array(values, dtype=np.float64).reshape(shape)
    array.flags.writeable = False
    return array


@dataclass(frozen=True, kw_only=True, eq=False)
class Inertial:
    """Mass [kg], centre of mass (3) [m] and inertia (3, 3) [kg m2] of a body.

    The inertia is about the centre of mass. All values are in the same frame.
    """

    mass: float
    centre_of_mass: Array
    inertia: Array

    @staticmethod
    def zero() -> Inertial:
        return Inertial(
            mass=0.0,
            centre_of_mass=constant(np.zeros(3), (3,)),
            inertia=constant(np.zeros((3, 3)), (3, 3)),
        )

    def seen_from(self, rotation: Array, translation: Array) -> Inertial:
        """Return the values of this body in a new frame.

        (rotation, translation) is the pose of the old frame in the new frame.
        """
        return Inertial(
            mass=self.mass,
            centre_of_mass=constant(rotation @ self.centre_of_mass + translation, (3,)),
            inertia=constant(rotation @ self.inertia @ rotation.T, (3, 3)),
        )

    def merged_with(self, other: Inertial) -> Inertial:
        """Return one rigid body that consists of this body and `other`.

        Both bodies must be given in the same frame.
        """
        mass = self.mass + other.mass
        if mass == 0.0:
            return self
        centre = (self.mass * self.centre_of_mass + other.mass * other.centre_of_mass) / mass
        inertia = sum(
            (
                part.inertia + part.mass * _parallel_axis(part.centre_of_mass - centre)
                for part in (self, other)
            ),
            start=np.zeros((3, 3)),
        )
        return Inertial(
            mass=mass, centre_of_mass=constant(centre, (3,)), inertia=constant(inertia, (3, 3))
        )

    def check(self, subject: str) -> None:
        """Check that a rigid body can have these values.

        `subject` is the name of the body in messages. Raises RobotError if a value is not finite,
        if the mass is not positive, if the inertia is not positive definite, or if the inertia
        violates the triangle inequality.
        """
        if not (
            np.isfinite(self.mass)
            and np.isfinite(self.centre_of_mass).all()
            and np.isfinite(self.inertia).all()
        ):
            raise RobotError(f"{subject}: mass, centre of mass and inertia must be finite numbers")
        if self.mass <= 0.0:
            raise RobotError(f"{subject}: mass is {self.mass:g} kg; it must be greater than zero")
        moments = np.linalg.eigvalsh(self.inertia)
        shown = ", ".join(f"{moment:.6g}" for moment in moments)
        if moments[0] <= 0.0:
            raise RobotError(
                f"{subject}: inertia is not positive definite; its principal moments are ({shown}) kg m2"
            )
        if moments[0] + moments[1] < moments[2] * (1.0 - 1e-9):
            raise RobotError(
                f"{subject}: inertia violates the triangle inequality; its principal moments are ({shown}) kg m2, "
                f"and the largest must not exceed the sum of the other two"
            )


def _parallel_axis(offset: Array) -> Array:
    return np.asarray(offset @ offset * np.eye(3) - np.outer(offset, offset))


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """Revolute or prismatic joint. The z axis of the joint frame is the joint axis.

    `rotation` (3, 3) and `translation` (3) [m] are the pose of the joint frame in the parent body's
    frame at zero displacement. The limits of a revolute joint are in rad, rad/s and N m. The limits
    of a prismatic joint are in m, m/s and N. Infinity means that there is no limit.
    """

    name: str
    kind: Literal["revolute", "prismatic"]
    rotation: Array
    translation: Array
    lower: float = -np.inf
    upper: float = np.inf
    velocity_limit: float = np.inf
    effort_limit: float = np.inf


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """Free-flyer: base, joints, one body per joint, tool and end-effector. All values are SI.

    The values of `base` are given in B. The centre of mass of `base` is the origin of B.
    `base_attachment` is the part of the arm that is fixed to the base, given in B. `bodies[i]` is
    the body that joint i moves, given in the frame of joint i. `end_effector_rotation` and
    `end_effector_translation` are the pose of the end-effector frame E in the last joint frame.
    `tool` is fixed to the last body and is given in E. `posture` (n) contains the joint positions
    at the start. `appearance` is what a viewer shows in addition. No equation contains it.

    Raises RobotError if sizes are inconsistent or if values are impossible.
    """

    name: str
    base: Inertial
    base_attachment: Inertial
    joints: tuple[Joint, ...]
    bodies: tuple[Inertial, ...]
    end_effector_rotation: Array
    end_effector_translation: Array
    tool: Inertial = field(default_factory=Inertial.zero)
    posture: Array
    appearance: Appearance = field(default_factory=Appearance)

    def __post_init__(self) -> None:
        # Check the base, and the sizes of the chain.
        self.base.check(f"robot {self.name}, base")
        if np.abs(self.base.centre_of_mass).max() > 0.0:
            raise RobotError(
                f"robot {self.name}: the base frame's origin must be the base's centre of mass"
            )
        if not self.joints:
            raise RobotError(
                f"robot {self.name}: there is no free joint between base and end-effector; at least one free joint is expected"
            )
        if len(self.bodies) != len(self.joints):
            raise RobotError(
                f"robot {self.name}: {len(self.bodies)} bodies for {len(self.joints)} joints; one body per joint is expected"
            )
        if self.posture.shape != (len(self.joints),):
            raise RobotError(
                f"robot {self.name}: posture has {self.posture.size} values; {len(self.joints)} values are expected, one for each free joint: "
                f"{', '.join(joint.name for joint in self.joints)}"
            )
        # The last body is checked together with the tool. One of the two may have zero mass.
        last = len(self.joints) - 1
        for index, (joint, body) in enumerate(zip(self.joints, self.bodies, strict=True)):
            tool = self.tool.seen_from(self.end_effector_rotation, self.end_effector_translation)
            whole = body.merged_with(tool) if index == last else body
            whole.check(f"robot {self.name}, body moved by joint {joint.name}")
        # Check that the start posture is within the joint limits.
        for joint, value in zip(self.joints, self.posture, strict=True):
            if not np.isfinite(value):
                raise RobotError(
                    f"robot {self.name}: posture of joint {joint.name} is {value}; a finite number is expected"
                )
            if not joint.lower <= value <= joint.upper:
                raise RobotError(
                    f"robot {self.name}: posture of joint {joint.name} is {value:g}, outside the joint's limits "
                    f"[{joint.lower:g}, {joint.upper:g}]"
                )

    @property
    def joint_count(self) -> int:
        """Number of free joints."""
        return len(self.joints)
