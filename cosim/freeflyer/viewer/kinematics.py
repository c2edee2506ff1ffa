"""Forward kinematics of a scene, for many times at once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from freeflyer.fmi.component import Array

Poses = list[tuple[Rotation, Array]]
"""For each frame: its rotations (n) and positions (n, 3) [m] in the inertial frame I."""


def frames(scene: Mapping[str, Any], position: Array, orientation: Array, joints: Array) -> Poses:
    """Return the poses of the base, of the frame of each joint, and of the end-effector.

    `position` (n, 3) [m] and `orientation` (n, 4) [x, y, z, w] are those of the base in I.
    `joints` (n, joints) are the joint positions [rad or m].
    """
    rotation, place = Rotation.from_quat(orientation), np.asarray(position, dtype=float)
    found = [(rotation, place)]
    for joint, value in zip(scene["joints"], np.asarray(joints, dtype=float).T, strict=True):
        place = place + rotation.apply(joint["position"])
        rotation = rotation * Rotation.from_quat(joint["orientation"])
        along = np.column_stack([np.zeros((value.size, 2)), value])
        if joint["kind"] == "revolute":
            rotation = rotation * Rotation.from_rotvec(along)
        else:
            place = place + rotation.apply(along)
        found.append((rotation, place))
    last = scene["end_effector"]
    place = place + rotation.apply(last["position"])
    found.append((rotation * Rotation.from_quat(last["orientation"]), place))
    return found


def centre_of_mass(scene: Mapping[str, Any], poses: Poses) -> Array | None:
    """Return the centre of mass (n, 3) [m] in I, or None if the scene has no masses."""
    bodies = [body for body in scene["bodies"] if body["mass"] > 0.0]
    if not bodies:
        return None
    moments = sum(
        body["mass"]
        * (poses[body["frame"]][1] + poses[body["frame"]][0].apply(body["centre_of_mass"]))
        for body in bodies
    )
    return np.asarray(moments / sum(body["mass"] for body in bodies))
