"""Loading of a `Robot` from a URDF or from a robot file.

The robot is a serial chain from the base to the end-effector. Two bodies that are connected by a
fixed or locked joint are merged into one body.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from freeflyer.foundation import toml_file
from freeflyer.foundation.file_name import text_of
from freeflyer.foundation.suggestions import did_you_mean, unknown_keys
from freeflyer_fmus.errors import RobotError
from freeflyer_fmus.robot.robot import Array, Inertial, Joint, Robot, constant
from freeflyer_fmus.robot.urdf_tree import UrdfJoint, UrdfTree
from freeflyer_fmus.robot.urdf_visuals import read_visuals
from freeflyer_fmus.robot.visual import Appearance, Visual

ROBOTS = Path(__file__).parent.parent / "robots"
DEFAULT_ROBOT = ROBOTS / "lwr4_free_flyer.toml"


def shipped_robots() -> list[str]:
    return sorted(path.stem for path in ROBOTS.glob("*.toml"))


def robot_path(text: str, directory: Path = Path()) -> Path:
    """Return the path of a robot file.

    `text` is the name of a shipped robot, or a file name with a suffix, relative to `directory`.
    Raises RobotError if `text` is not a shipped robot and contains no ".".
    """
    if text not in shipped_robots() and "." not in text:
        raise RobotError(
            f"robot {text!r} is neither a shipped robot nor a file name with a suffix{did_you_mean(text, shipped_robots())}"
        )
    return ROBOTS / f"{text}.toml" if text in shipped_robots() else directory / text


def load_robot(
    source: str | os.PathLike[str] = DEFAULT_ROBOT.stem,
    *,
    base_link: str | None = None,
    end_effector: str | None = None,
    tool_link: str | None = None,
    lock: Mapping[str, float] | None = None,
    posture: Mapping[str, float] | Sequence[float] | None = None,
) -> Robot:
    """Return a robot. `source` is the name of a shipped robot, a robot file (.toml), or a URDF.

    The keywords apply to a URDF only. `base_link` (default: the root) is the floating base,
    `end_effector` (default: the only link without children) has the frame E, and the mass and
    inertia of `tool_link` become FMU parameters. `lock` fixes joints at positions [rad or m], and
    `posture` has the start positions [rad or m] of the free joints. Raises RobotError.
    """
    path = robot_path(text_of(source, "the robot", RobotError))
    given = [base_link, end_effector, tool_link, posture, *(lock or ())]
    if path.suffix != ".toml":
        return load_urdf(
            path,
            base_link=base_link,
            end_effector=end_effector,
            tool_link=tool_link,
            lock=lock,
            posture=posture,
        )
    if any(value is not None for value in given):
        raise RobotError(
            "--base-link, --end-effector, --tool-link, --lock and --posture apply only to a URDF; select a URDF file with --robot"
        )
    return load_robot_file(path)


def load_robot_file(path: Path = DEFAULT_ROBOT) -> Robot:
    """Read a TOML file with URDF, base link, end-effector, tool, locked joints and posture.

    Raises RobotError if the file is invalid or if the robot in this file is invalid.
    """
    try:
        data = toml_file.read(path)
    except (OSError, ValueError) as error:
        raise RobotError(f"robot file {path} cannot be read: {error}") from error
    known = ("urdf", "base_link", "end_effector", "tool_link", "lock", "posture")
    for key, hint in unknown_keys(data, known):
        raise RobotError(f"robot file {path}: unknown key {key!r}{hint}")
    if not isinstance(data.get("urdf"), str):
        raise RobotError(f"robot file {path}: 'urdf' must be the path of a URDF file")
    return load_urdf(
        path.parent / data["urdf"],
        base_link=data.get("base_link"),
        end_effector=data.get("end_effector"),
        tool_link=data.get("tool_link"),
        lock=data.get("lock", {}),
        posture=data.get("posture"),
    )


def load_urdf(
    path: Path,
    *,
    base_link: str | None = None,
    end_effector: str | None = None,
    tool_link: str | None = None,
    lock: Mapping[str, float] | None = None,
    posture: Mapping[str, float] | Sequence[float] | None = None,
) -> Robot:
    """Read a URDF as a free-flyer.

    `base_link` (default: the root) becomes the floating base. `end_effector` (default: the only
    link without children) is the link whose frame is E. The mass and inertia of `tool_link`
    (default: none) become FMU parameters. `lock` fixes joints at the given positions [rad or m].
    The other joints of the chain are free. `posture` contains the start positions of the free
    joints, either by name or as a list in the order of the chain. Without `posture`, every free
    joint starts at zero, or in the middle of its limits if zero is outside the limits. Raises
    RobotError if the file is malformed, if the robot is not a serial chain, or if the robot is
    physically impossible.
    """
    tree = UrdfTree(path)
    base = base_link or tree.root
    tree.require_link(base, "base link")
    tip = end_effector or tree.only_leaf(base)
    tree.require_link(tip, "end-effector")
    if tool_link is not None:
        tree.require_link(tool_link, "tool link")
    return _robot(tree, base, tip, tool_link, dict(lock or {}), posture)


def _robot(
    tree: UrdfTree,
    base: str,
    tip: str,
    tool: str | None,
    lock: dict[str, float],
    posture: Mapping[str, float] | Sequence[float] | None,
) -> Robot:
    path = tree.chain(base, tip)
    # Check the locked joints. The names must exist. The values must be finite and within the
    # limits.
    for name, value in lock.items():
        if name not in tree.joints:
            raise RobotError(
                f"URDF {tree.path}: locked joint {name!r} does not exist{did_you_mean(name, tree.joints)}"
            )
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not math.isfinite(value)
        ):
            raise RobotError(
                f"URDF {tree.path}: joint {name} is locked at {value!r}; a finite number is expected"
            )
        joint = tree.joints[name]
        if not joint.lower <= value <= joint.upper:
            limits = f"[{joint.lower:g}, {joint.upper:g}]"
            raise RobotError(
                f"URDF {tree.path}: joint {name} is locked at {value:g}, outside the joint's limits {limits}"
            )
    # The base body. The origin of B is the centre of mass of this body. The axes of B are the axes
    # of the base link.
    base_inertial = tree.links[base]
    if base_inertial is None:
        raise RobotError(
            f"URDF {tree.path}: base link {base!r} has no mass; a floating base needs an <inertial>"
        )
    tree.refuse_mass_above(base)
    rotation, translation = np.eye(3), -base_inertial.centre_of_mass
    free: list[Joint] = []
    bodies: list[Inertial] = []
    visuals: list[Visual] = []
    shapes, notes = read_visuals(tree)

    def draw(link: str, rotation: Array, translation: Array) -> None:
        """Collect the shapes of a link. Its pose is given in the frame of the last free joint."""
        visuals.extend(
            shape.placed(len(free), rotation, translation) for shape in shapes.get(link, ())
        )

    first = path[0] if path else None
    body = _welded(tree, base, rotation, translation, first, {base, tool}, lock, tip, draw)
    mount_rotation, mount_translation = rotation, translation
    if first is not None:
        mount_rotation, mount_translation = first.rotation, translation + first.translation
    # Go along the chain from the base to the end-effector. A free joint starts a new body. The
    # frame of the new body is the joint frame, and its z axis is the joint axis.
    link, tool_pose = base, None
    for joint, following in zip(path, [*path[1:], None], strict=True):
        translation = translation + rotation @ joint.translation
        rotation = rotation @ joint.rotation
        if joint.kind == "fixed" or joint.name in lock:
            rotation, translation = joint.displaced(
                rotation, translation, lock.get(joint.name, 0.0)
            )
        else:
            align = _z_onto(joint.axis)
            free.append(joint.free(_exact(rotation @ align), constant(translation, (3,))))
            bodies.append(body)
            body, tool_pose = Inertial.zero(), None
            rotation, translation = align.T, np.zeros(3)
        link = joint.child
        body = body.merged_with(
            _welded(tree, link, rotation, translation, following, {base, tool}, lock, tip, draw)
        )
        if link == tool:
            tool_pose = (rotation, translation)
    bodies.append(body)
    # Frame E, and the inertia of the tool in E.
    end_rotation, end_translation = _exact(rotation), constant(translation, (3,))
    tool_inertial = Inertial.zero()
    if tool is not None:
        mass = tree.links[tool]
        if tool_pose is None or mass is None:
            raise RobotError(
                f"URDF {tree.path}: tool link {tool!r} must have an <inertial> and be between the last free joint "
                f"and the end-effector {tip!r}"
            )
        tool_rotation = end_rotation.T @ tool_pose[0]
        tool_inertial = mass.seen_from(
            tool_rotation, end_rotation.T @ (tool_pose[1] - end_translation)
        )
    return Robot(
        name=tree.name,
        base=base_inertial.seen_from(np.eye(3), -base_inertial.centre_of_mass),
        base_attachment=bodies[0],
        joints=tuple(free),
        bodies=tuple(bodies[1:]),
        end_effector_rotation=end_rotation,
        end_effector_translation=end_translation,
        tool=tool_inertial,
        posture=_posture(tree, free, posture),
        appearance=Appearance(
            visuals=tuple(visuals),
            mount_rotation=mount_rotation,
            mount_translation=mount_translation,
            locked=lock,
            notes=tuple(notes),
        ),
    )


def _welded(
    tree: UrdfTree,
    link: str,
    rotation: Array,
    translation: Array,
    skip: UrdfJoint | None,
    apart: set[str | None],
    lock: Mapping[str, float],
    tip: str,
    draw: Callable[[str, Array, Array], None],
) -> Inertial:
    """Return the mass and inertia of `link` and of all links that are fixed to it.

    (rotation, translation) is the pose of `link` in the frame of its body. The result is in the
    frame of the body. The joint `skip` continues the chain; the links below this joint are not
    included. The mass of a link in `apart` is not included. `draw` is called with each link and its
    pose. Raises RobotError if a free joint is not on the chain to the end-effector `tip`.
    """
    draw(link, rotation, translation)
    own = tree.links[link]
    total = (
        Inertial.zero() if own is None or link in apart else own.seen_from(rotation, translation)
    )
    for joint in tree.children[link]:
        if joint is skip:
            continue
        if joint.kind != "fixed" and joint.name not in lock:
            raise RobotError(
                f"URDF {tree.path}: not a serial chain: joint {joint.name!r} moves a branch that is not on the path "
                f"to {tip!r}; lock this joint or choose another end-effector"
            )
        R, r = rotation @ joint.rotation, translation + rotation @ joint.translation
        R, r = joint.displaced(R, r, lock.get(joint.name, 0.0))
        total = total.merged_with(_welded(tree, joint.child, R, r, None, apart, lock, tip, draw))
    return total


def _posture(
    tree: UrdfTree, free: Sequence[Joint], posture: Mapping[str, float] | Sequence[float] | None
) -> Array:
    names = [joint.name for joint in free]
    if posture is None:
        return constant([_neutral(joint) for joint in free], (len(free),))
    if isinstance(posture, Mapping):
        for name in posture:
            if name not in names:
                raise RobotError(
                    f"URDF {tree.path}: posture contains {name!r}, which is not a free joint{did_you_mean(name, names)}"
                )
        missing = [name for name in names if name not in posture]
        if missing:
            raise RobotError(f"URDF {tree.path}: posture lacks the joints {', '.join(missing)}")
        posture = [posture[name] for name in names]
    return constant(posture, (len(posture),))


def _neutral(joint: Joint) -> float:
    if joint.lower <= 0.0 <= joint.upper:
        return 0.0
    return 0.5 * (joint.lower + joint.upper)


def _z_onto(axis: Array) -> Array:
    """Return a rotation matrix with the third column `axis`.

    If `axis` is a coordinate axis, all entries are exactly 0, 1 or -1.
    """
    helper = np.eye(3)[0 if abs(axis[1]) > 0.9 else 1]
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])


def _exact(rotation: Array) -> Array:
    """Round the entries that differ by less than 1e-15 from 0, 1 or -1.

    The generated code omits products with an exact zero. Therefore the code is shorter.
    """
    nearest = np.round(rotation)
    return constant(np.where(np.abs(rotation - nearest) < 1e-15, nearest, rotation) + 0.0, (3, 3))
