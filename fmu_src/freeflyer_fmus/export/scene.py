"""Scene: the geometry of a robot as JSON, for viewers.

Every FMU of a block with a robot contains the scene as SCENE. docs/fmus.md describes the format.
The scene of a robot without meshes needs no package of the extra `export`.
"""

from __future__ import annotations

import base64
import functools
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from freeflyer.foundation.errors import CosimError
from freeflyer_fmus.export.inertia_shapes import inertia_shapes
from freeflyer_fmus.export.mesh import Part, drawable, read_meshes
from freeflyer_fmus.robot.robot import Array, Inertial, Robot
from freeflyer_fmus.robot.urdf import DEFAULT_ROBOT, load_robot
from freeflyer_fmus.robot.urdf_visuals import shortened
from freeflyer_fmus.robot.visual import Visual

SCENE = "extra/org.freeflyer/scene.json"
"""Path of the scene inside an FMU."""
FORMAT = 1
MOST_TRIANGLES, MOST_TRIANGLES_OF_ROBOT = 4_000, 60_000
"""Largest number of triangles of one mesh, and of all meshes of a robot."""
GREY = (0.75, 0.76, 0.78, 1.0)
"""Color of shapes without color."""


def robot_scene(
    source: str | os.PathLike[str] = DEFAULT_ROBOT.stem,
    *,
    base_link: str | None = None,
    end_effector: str | None = None,
    tool_link: str | None = None,
    lock: Mapping[str, float] | None = None,
    posture: Mapping[str, float] | Sequence[float] | None = None,
) -> dict[str, Any]:
    """Return the scene of a robot, in SI units. docs/fmus.md describes its keys.

    `source` is the name of a shipped robot, a robot file (.toml), or a URDF. `base_link`,
    `end_effector`, `tool_link`, `lock` [rad or m] and `posture` apply to a URDF, as in
    `load_robot`. A shape that cannot be drawn is a sentence in the list `notes` of the scene.
    Raises RobotError for an invalid robot.
    """
    return scene(
        load_robot(
            source,
            base_link=base_link,
            end_effector=end_effector,
            tool_link=tool_link,
            lock=lock,
            posture=posture,
        )
    )


def read_robot(path: Path, options: Mapping[str, Any]) -> dict[str, Any]:
    """Read a robot for the viewer (entry point). `options` are keywords of `load_robot`."""
    robot = load_robot(path, **options)
    return {"scene": scene(robot), "posture": robot.posture.tolist()}


def scene_json(robot: Robot) -> bytes:
    """Return the scene as JSON. Equal robots give equal bytes."""
    return json.dumps(scene(robot), separators=(",", ":"), allow_nan=False).encode("ascii")


@functools.lru_cache(maxsize=4)  # several FMUs contain the scene of one robot
def scene(robot: Robot) -> dict[str, Any]:
    """Return the scene of a robot. The result is shared and must not be changed."""
    look, notes = robot.appearance, list(robot.appearance.notes)
    visuals = _drawn(look.visuals, notes)
    drawn = "urdf" if visuals else "inertia"
    return {
        "format": FORMAT,
        "name": robot.name,
        "joints": [
            {
                "name": joint.name,
                "kind": joint.kind,
                **_pose(joint.rotation, joint.translation),
                "lower": _limit(joint.lower),
                "upper": _limit(joint.upper),
            }
            for joint in robot.joints
        ],
        "locked": [{"name": name, "position": float(value)} for name, value in look.locked.items()],
        "end_effector": _pose(robot.end_effector_rotation, robot.end_effector_translation),
        "mount": _pose(look.mount_rotation, look.mount_translation),
        "bodies": _bodies(robot),
        "visuals": visuals or _drawn(inertia_shapes(robot), notes),
        "drawn": drawn,
        "notes": notes,
    }


def _drawn(visuals: Iterable[Visual], notes: list[str]) -> list[dict[str, Any]]:
    """Return the shapes. A note is added for each mesh that cannot be drawn."""
    shapes = list(visuals)
    paths = [visual.mesh for visual in shapes if visual.mesh is not None]
    most = min(MOST_TRIANGLES, MOST_TRIANGLES_OF_ROBOT // max(len(paths), 1))
    files = read_meshes(dict.fromkeys(paths))
    result, reported = [], set()
    for visual in shapes:
        if visual.mesh is None:
            result.append(_shape(visual))
            continue
        whole = files[visual.mesh]
        try:
            if isinstance(whole, CosimError):
                raise whole
            parts = drawable(visual.mesh, whole, visual.size, most, colored=visual.color is None)
        except CosimError as error:
            reported.add(f"{error}; this mesh is not drawn")
        else:
            result += [_shape(visual, part) for part in parts]
    notes += shortened(sorted(reported))
    return result


def _shape(visual: Visual, part: Part | None = None) -> dict[str, Any]:
    color = visual.color or (part.color if part else None) or GREY
    shape: dict[str, Any] = {
        "frame": visual.frame,
        "name": visual.name,
        **_pose(visual.rotation, visual.translation),
        "color": _numbers(color),
        "shape": visual.shape,
    }
    if part is not None:
        shape["vertices"] = base64.b64encode(part.vertices.astype("<f4").tobytes()).decode()
        shape["triangles"] = base64.b64encode(part.triangles.astype("<u4").tobytes()).decode()
    elif visual.shape == "box":
        shape["size"] = _numbers(visual.size)
    else:
        shape |= zip(("radius", "length"), _numbers(visual.size), strict=False)
    return shape


def _bodies(robot: Robot) -> list[dict[str, Any]]:
    """Return the rigid bodies with mass: base, part of the arm at the base, moved bodies, tool."""
    n = robot.joint_count
    bodies = [(0, "base", robot.base), (0, "base_attachment", robot.base_attachment)]
    bodies += [
        (k, joint.name, body)
        for k, (joint, body) in enumerate(zip(robot.joints, robot.bodies, strict=True), 1)
    ]
    bodies.append((n + 1, "tool", robot.tool))
    return [_body(*body) for body in bodies if body[2].mass > 0.0]


def _body(frame: int, name: str, body: Inertial) -> dict[str, Any]:
    inertia = body.inertia
    entries = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return {
        "frame": frame,
        "name": name,
        "mass": _number(body.mass),
        "centre_of_mass": _numbers(body.centre_of_mass),
        "inertia": _numbers(entries),
    }


def _pose(rotation: Array, translation: Array) -> dict[str, list[float]]:
    quaternion = Rotation.from_matrix(np.asarray(rotation)).as_quat(canonical=True)
    return {"position": _numbers(translation), "orientation": _numbers(quaternion)}


def _numbers(values: Iterable[float]) -> list[float]:
    return [_number(value) for value in values]


def _number(value: float) -> float:
    """Round to 13 digits, so that rounding errors of a platform do not change the bytes."""
    rounded = float(f"{float(value):.13g}")
    return 0.0 if abs(rounded) < 1e-15 else rounded


def _limit(value: float) -> float | None:
    return _number(value) if math.isfinite(value) else None
