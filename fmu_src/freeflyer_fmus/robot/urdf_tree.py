"""Links and joints of a URDF file, with a check of each element.

The XML is parsed without a robotics library, because the checks need the `<inertial>` element of
every link. Robotics libraries merge or discard some of these elements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from freeflyer.foundation import bounded_file
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer_fmus.errors import RobotError
from freeflyer_fmus.robot.robot import Array, Inertial, Joint, constant

LARGEST_FILE = 16 << 20
"""Largest size of a URDF [bytes]."""
MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class UrdfJoint:
    """URDF joint with the values of the file.

    `axis` is in the frame of the child link. `rotation` and `translation` are the pose of the joint
    frame in the frame of the parent link.
    """

    name: str
    kind: str
    parent: str
    child: str
    rotation: Array
    translation: Array
    axis: Array
    lower: float
    upper: float
    velocity: float
    effort: float

    def displaced(
        self, rotation: Array, translation: Array, position: float
    ) -> tuple[Array, Array]:
        """Return the pose of the child link if the joint is locked at `position` [rad or m].

        (rotation, translation) is the pose of the joint frame. Both poses are in the same frame.
        """
        if self.kind == "prismatic":
            return rotation, translation + rotation @ self.axis * position
        if self.kind == "fixed" or position == 0.0:
            return rotation, translation
        return rotation @ _rotation_about(self.axis, position), translation

    def free(self, rotation: Array, translation: Array) -> Joint:
        return Joint(
            name=self.name,
            kind="prismatic" if self.kind == "prismatic" else "revolute",
            rotation=rotation,
            translation=translation,
            lower=self.lower,
            upper=self.upper,
            velocity_limit=self.velocity,
            effort_limit=self.effort,
        )


class UrdfTree:
    """Links and joints of one URDF file. Raises RobotError if the file is invalid."""

    def __init__(self, path: Path) -> None:
        try:
            root = ElementTree.fromstring(bounded_file.content(path, LARGEST_FILE))
        except OSError as error:
            raise RobotError(f"URDF {path} cannot be read: {error.strerror}") from error
        except (ElementTree.ParseError, ValueError, LookupError) as error:  # also: encodings
            raise RobotError(f"URDF {path} is not well-formed XML: {error}") from error
        if root.tag != "robot":
            raise RobotError(f"URDF {path}: the root element is <{root.tag}>; <robot> is expected")
        self.path, self.element = path, root
        self.name = root.get("name", path.stem)
        self.links: dict[str, Inertial | None] = {}
        for element in root.findall("link"):
            name = self._attribute(element, "name", "a link")
            if name in self.links:
                raise RobotError(f"URDF {path}: link {name!r} is defined twice")
            self.links[name] = self._inertial(element, name)
        self.joints: dict[str, UrdfJoint] = {}
        self.parent: dict[str, UrdfJoint] = {}
        self.children: dict[str, list[UrdfJoint]] = {name: [] for name in self.links}
        for element in root.findall("joint"):
            self._add(self._joint(element))
        roots = [name for name in self.links if name not in self.parent]
        if len(roots) != 1:
            found = ", ".join(roots) or "none: the joints form a loop"
            raise RobotError(f"URDF {path}: one root link is expected, found {found}")
        self.root = roots[0]

    def require_link(self, name: str, role: str) -> None:
        if name not in self.links:
            raise RobotError(
                f"URDF {self.path}: {role} {name!r} does not exist{did_you_mean(name, self.links)}"
            )

    def only_leaf(self, base: str) -> str:
        leaves, stack = [], [base]
        while stack:
            link = stack.pop()
            stack += [joint.child for joint in self.children[link]]
            if not self.children[link]:
                leaves.append(link)
        if len(leaves) > 1:
            raise RobotError(
                f"URDF {self.path}: the chain ends in several links ({', '.join(sorted(leaves))}); choose one of these links as end-effector"
            )
        return leaves[0]

    def chain(self, base: str, tip: str) -> list[UrdfJoint]:
        """Return the joints from `base` to `tip`.

        Raises RobotError if `tip` is not below `base`.
        """
        path, link = [], tip
        while link != base:
            joint = self.parent.get(link)
            if joint is None:
                raise RobotError(
                    f"URDF {self.path}: not a serial chain: {tip!r} is not a descendant of {base!r}"
                )
            path.append(joint)
            link = joint.parent
        return path[::-1]

    def refuse_mass_above(self, base: str) -> None:
        """Raise RobotError if a link with mass is neither the base link nor below the base link.

        Such a link would be missing from the robot.
        """
        below, stack = set(), [base]
        while stack:
            link = stack.pop()
            below.add(link)
            stack += [joint.child for joint in self.children[link]]
        lost = sorted(
            name
            for name, inertial in self.links.items()
            if inertial is not None and name not in below
        )
        if lost:
            raise RobotError(
                f"URDF {self.path}: links {', '.join(lost)} have mass but are not below the base link {base!r}; "
                f"choose {self.root!r} as base link"
            )

    def _add(self, joint: UrdfJoint) -> None:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in self.links:
                raise RobotError(
                    f"URDF {self.path}: joint {joint.name!r} has {role} link {link!r}, which does not exist{did_you_mean(link, self.links)}"
                )
        if joint.name in self.joints:
            raise RobotError(f"URDF {self.path}: joint {joint.name!r} is defined twice")
        if joint.child in self.parent:
            raise RobotError(
                f"URDF {self.path}: not a tree: link {joint.child!r} is the child of both joints {self.parent[joint.child].name!r} "
                f"and {joint.name!r}"
            )
        self.joints[joint.name] = joint
        self.parent[joint.child] = joint
        self.children[joint.parent].append(joint)

    def _joint(self, element: ElementTree.Element) -> UrdfJoint:
        # Only some kinds of joints are supported.
        name = self._attribute(element, "name", "a joint")
        kind = self._attribute(element, "type", f"joint {name!r}")
        if kind not in ("fixed", *MOVING):
            raise RobotError(
                f"URDF {self.path}: joint {name!r} is of type {kind!r}; fixed, revolute, continuous or prismatic is expected"
            )
        if element.find("mimic") is not None:
            raise RobotError(
                f"URDF {self.path}: joint {name!r} has a <mimic> element; a joint without <mimic> is expected"
            )
        # Placement, axis and limits.
        parent, child = element.find("parent"), element.find("child")
        if parent is None or child is None:
            raise RobotError(f"URDF {self.path}: joint {name!r} lacks its parent or child link")
        subject = f"joint {name!r}"
        rotation, translation = self.origin(element.find("origin"), subject)
        axis_element = element.find("axis")
        axis = (
            np.array([1.0, 0.0, 0.0])
            if axis_element is None
            else self.vector(axis_element, "xyz", subject)
        )
        if kind != "fixed" and not np.linalg.norm(axis) > 0.0:
            raise RobotError(f"URDF {self.path}: joint {name!r} has an axis of zero length")
        limit = element.find("limit")
        bounded = limit is not None and kind in ("revolute", "prismatic")
        lower = self.number(limit, "lower", subject, 0.0) if bounded else -math.inf
        upper = self.number(limit, "upper", subject, 0.0) if bounded else math.inf
        if lower > upper:
            raise RobotError(
                f"URDF {self.path}: joint {name!r} has lower limit {lower:g} above upper limit {upper:g}"
            )
        return UrdfJoint(
            name=name,
            kind=kind,
            parent=self._attribute(parent, "link", subject),
            child=self._attribute(child, "link", subject),
            rotation=rotation,
            translation=translation,
            axis=axis / np.linalg.norm(axis) if kind != "fixed" else axis,
            lower=lower,
            upper=upper,
            velocity=self.number(limit, "velocity", subject, math.inf),
            effort=self.number(limit, "effort", subject, math.inf),
        )

    def _inertial(self, link: ElementTree.Element, name: str) -> Inertial | None:
        element = link.find("inertial")
        if element is None:
            return None
        subject = f"link {name!r}"
        mass_element, inertia_element = element.find("mass"), element.find("inertia")
        if mass_element is None or inertia_element is None:
            raise RobotError(
                f"URDF {self.path}: {subject} has an <inertial> without <mass> or <inertia>"
            )
        mass = self.number(mass_element, "value", subject, None)
        entry = {
            key: self.number(inertia_element, key, subject, 0.0)
            for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        }
        inertia = np.array(
            [
                [entry["ixx"], entry["ixy"], entry["ixz"]],
                [entry["ixy"], entry["iyy"], entry["iyz"]],
                [entry["ixz"], entry["iyz"], entry["izz"]],
            ]
        )
        if mass == 0.0 and not inertia.any():
            return None
        rotation, translation = self.origin(element.find("origin"), subject)
        inertial = Inertial(
            mass=mass, centre_of_mass=constant(np.zeros(3), (3,)), inertia=constant(inertia, (3, 3))
        )
        inertial = inertial.seen_from(rotation, translation)
        inertial.check(f"URDF {self.path}, {subject}")
        return inertial

    def origin(self, element: ElementTree.Element | None, subject: str) -> tuple[Array, Array]:
        if element is None:
            return np.eye(3), np.zeros(3)
        return _rotation_from_rpy(self.vector(element, "rpy", subject)), self.vector(
            element, "xyz", subject
        )

    def vector(
        self,
        element: ElementTree.Element | None,
        key: str,
        subject: str,
        count: int = 3,
        default: str = "0 0 0",
    ) -> Array:
        text = default if element is None else element.get(key, default)
        try:
            values = np.array([float(part) for part in text.split()])
        except ValueError:
            values = np.array([])
        if values.shape != (count,) or not np.isfinite(values).all():
            number = {3: "three", 4: "four"}[count]
            raise RobotError(
                f"URDF {self.path}: {subject} has {key}={text!r}; {number} finite numbers are expected"
            )
        return values

    def number(
        self, element: ElementTree.Element | None, key: str, subject: str, default: float | None
    ) -> float:
        text = None if element is None else element.get(key)
        if text is None and default is not None:
            return default
        try:
            value = float(text or "")
        except ValueError:
            value = math.nan
        if math.isnan(value):
            raise RobotError(
                f"URDF {self.path}: {subject} has {key}={text!r}; a number is expected"
            )
        return value

    def _attribute(self, element: ElementTree.Element, key: str, subject: str) -> str:
        value = element.get(key)
        if not value:
            raise RobotError(f"URDF {self.path}: {subject} lacks the attribute {key!r}")
        return value


def _rotation_from_rpy(rpy: Array) -> Array:
    """Return the rotation matrix of the angles roll, pitch, yaw about fixed axes, as in URDF."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _rotation_about(axis: Array, angle: float) -> Array:
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross)
