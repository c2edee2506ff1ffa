"""Shapes that show a robot: what a viewer draws, without influence on the equations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Color = tuple[float, float, float, float]
LARGEST = 1e4
"""Largest size and distance of a shape [m]. A larger shape would hide the robot."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Visual:
    """Shape of a link, in frame `frame`: 0 is B, and k is the frame of free joint k.

    `rotation` (3, 3) and `translation` (3) [m] are the pose of the shape in this frame. `size` [m]
    contains the edges of a box, the radius of a sphere, or radius and length of a cylinder or
    capsule along z. The length of a capsule does not include its caps. `size` of a mesh contains
    the factors of its coordinates, and `mesh` its file. `color` contains red, green, blue and
    opacity from 0 to 1; None means that the file of the mesh, or else the viewer, determines it.
    """

    name: str
    shape: Literal["box", "sphere", "cylinder", "capsule", "mesh"]
    size: tuple[float, ...]
    rotation: Array
    translation: Array
    color: Color | None = None
    mesh: Path | None = None
    frame: int = 0

    def placed(self, frame: int, rotation: Array, translation: Array) -> Visual:
        """Return this shape in another frame.

        (rotation, translation) is the pose of the old frame in the new frame `frame`.
        """
        return replace(
            self,
            frame=frame,
            rotation=rotation @ self.rotation,
            translation=rotation @ self.translation + translation,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Appearance:
    """What a viewer shows of a robot beyond its joints and bodies.

    `mount_rotation` (3, 3) and `mount_translation` (3) [m] are the pose of the arm's base in B.
    `locked` contains the positions [rad or m] of the locked joints of the chain. `notes` are
    sentences about shapes that cannot be drawn.
    """

    visuals: tuple[Visual, ...] = ()
    mount_rotation: Array = field(default_factory=lambda: np.eye(3))
    mount_translation: Array = field(default_factory=lambda: np.zeros(3))
    locked: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    notes: tuple[str, ...] = ()
