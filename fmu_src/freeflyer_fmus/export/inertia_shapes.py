"""Shapes of a robot that has none: capsules between the joints, and a box for the base.

A revolute joint is a cylinder along its axis. A prismatic joint is a cuboid along its axis.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from freeflyer.foundation.equal_inertia_box import equal_inertia_box
from freeflyer_fmus.robot.robot import Array, Robot
from freeflyer_fmus.robot.visual import Visual

BASE = (0.80, 0.66, 0.35, 0.35)
"""Color of the base. It is translucent, because the box can contain a part of the arm."""
LINK, JOINT, TOOL = (0.88, 0.89, 0.91, 1.0), (0.35, 0.37, 0.40, 1.0), (0.90, 0.45, 0.10, 1.0)


def inertia_shapes(robot: Robot) -> Iterator[Visual]:
    """Yield shapes from the joints, the inertia of the base, and the pose of the end-effector."""
    inertia = robot.base.inertia
    entries = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    edges, orientation = equal_inertia_box(robot.base.mass, entries)
    yield Visual(
        name="base",
        shape="box",
        size=edges,
        rotation=Rotation.from_quat(orientation).as_matrix(),
        translation=np.zeros(3),
        color=BASE,
    )
    # Link k begins at the origin of frame k (link 0: at the mount) and ends at the next origin.
    ends = [*(joint.translation for joint in robot.joints), robot.end_effector_translation]
    begins = [robot.appearance.mount_translation, *[np.zeros(3)] * robot.joint_count]
    reach = sum(float(np.linalg.norm(end)) for end in ends[1:])
    radius = 0.035 * (reach or 1.0)
    for frame, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        length = float(np.linalg.norm(end - begin))
        if length > 0.2 * radius:
            yield Visual(
                name=f"link {frame}",
                shape="capsule",
                size=(radius, length),
                rotation=_z_along((end - begin) / length),
                translation=0.5 * (begin + end),
                color=LINK,
                frame=frame,
            )
    for frame, joint in enumerate(robot.joints, 1):
        revolute = joint.kind == "revolute"
        yield Visual(
            name=joint.name,
            shape="cylinder" if revolute else "box",
            size=(1.3 * radius, 2.8 * radius) if revolute else (2 * radius, 2 * radius, 4 * radius),
            rotation=np.eye(3),
            translation=np.zeros(3),
            color=JOINT,
            frame=frame,
        )
    R, r = robot.end_effector_rotation, robot.end_effector_translation
    yield Visual(
        name="tool",
        shape="box",
        size=(2.4 * radius, 2.4 * radius, 1.2 * radius),
        rotation=R,
        translation=r + R @ robot.tool.centre_of_mass,
        color=TOOL,
        frame=robot.joint_count,
    )


def _z_along(axis: Array) -> Array:
    rotation: Array = Rotation.align_vectors([axis], [[0.0, 0.0, 1.0]])[0].as_matrix()
    return rotation
