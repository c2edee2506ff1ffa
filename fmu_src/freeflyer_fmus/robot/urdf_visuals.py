"""Shapes of a URDF file: its <visual> elements.

A shape has no influence on the equations. Therefore a shape that cannot be drawn is a note and not
an error.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from freeflyer_fmus.errors import RobotError
from freeflyer_fmus.robot.urdf_tree import UrdfTree
from freeflyer_fmus.robot.visual import LARGEST, Color, Visual

MOST_VISUALS = 1000
"""Largest number of shapes that are read from one file."""
MOST_NOTES = 5
"""Largest number of notes about one kind of shape."""
_SIZES = {"sphere": ("radius",), "cylinder": ("radius", "length"), "capsule": ("radius", "length")}


def read_visuals(tree: UrdfTree) -> tuple[dict[str, list[Visual]], list[str]]:
    """Return the shapes of each link in the frame of the link, and notes about other shapes."""
    visuals: dict[str, list[Visual]] = {}
    failures: list[str] = []
    elements = _elements(tree)
    colors = _named_colors(tree, failures)
    for link, index, element in itertools.islice(elements, MOST_VISUALS):
        subject = f"visual {index} of link {link!r}"
        try:
            visuals.setdefault(link, []).append(_visual(tree, element, link, subject, colors))
        except RobotError as error:
            failures.append(f"{error}; this visual is not drawn")
    notes = shortened(failures)
    more = sum(1 for _ in elements)
    if more:
        notes.append(
            f"URDF {tree.path} has {MOST_VISUALS + more} visuals; only the first {MOST_VISUALS} are drawn"
        )
    return visuals, notes


def shortened(notes: Sequence[str]) -> list[str]:
    """Return at most MOST_NOTES of these notes, and the number of the others."""
    more = len(notes) - MOST_NOTES
    return [*notes[:MOST_NOTES], *([f"{more} other shapes have such errors"] if more > 0 else [])]


def _elements(tree: UrdfTree) -> Iterator[tuple[str, int, ElementTree.Element]]:
    for link in tree.element.findall("link"):
        for index, element in enumerate(link.findall("visual"), 1):
            yield link.get("name", ""), index, element


def _named_colors(tree: UrdfTree, failures: list[str]) -> dict[str, Color]:
    """Return the colors of the materials by name: those of the robot, then those of the links."""
    colors: dict[str, Color] = {}
    for element in (*tree.element.findall("material"), *tree.element.iterfind("link/visual/material")):  # fmt: skip
        name = element.get("name", "")
        if name and name not in colors and element.find("color") is not None:
            try:
                colors[name] = _color(tree, element, f"material {name!r}")
            except RobotError as error:
                failures.append(f"{error}; another color is drawn")
                if len(failures) > MOST_VISUALS:
                    break
    return colors


def _color(tree: UrdfTree, material: ElementTree.Element, subject: str) -> Color:
    red, green, blue, alpha = tree.vector(material.find("color"), "rgba", subject, 4)
    if not all(0.0 <= part <= 1.0 for part in (red, green, blue, alpha)):
        raise RobotError(
            f"URDF {tree.path}: {subject} has the color {red:g} {green:g} {blue:g} {alpha:g}; four numbers from 0 to 1 are expected"
        )
    return float(red), float(green), float(blue), float(alpha)


def _visual(
    tree: UrdfTree,
    element: ElementTree.Element,
    link: str,
    subject: str,
    colors: dict[str, Color],
) -> Visual:
    rotation, translation = tree.origin(element.find("origin"), subject)
    if not (np.abs(translation) <= LARGEST).all():
        raise RobotError(
            f"URDF {tree.path}: {subject} is more than {LARGEST:g} m from the origin of its link"
        )
    # The color. An invalid color of a visual is already in the notes if its material has a name.
    material, color = element.find("material"), None
    if material is not None:
        color = colors.get(material.get("name", ""))
        if color is None and material.find("color") is not None and not material.get("name"):
            color = _color(tree, material, subject)
    # The shape.
    geometry = element.find("geometry")
    kinds = [] if geometry is None else [part for part in geometry if isinstance(part.tag, str)]
    if len(kinds) != 1:
        raise RobotError(
            f"URDF {tree.path}: {subject} has {len(kinds)} shapes in <geometry>; one shape is expected"
        )
    (shape,) = kinds
    mesh = None
    if shape.tag == "mesh":
        mesh = _mesh_path(tree, shape.get("filename", ""), subject)
        size = tree.vector(shape, "scale", subject, 3, "1 1 1")
        allowed = (size != 0.0) & (np.abs(size) <= LARGEST)
    else:
        if shape.tag == "box":
            size = tree.vector(shape, "size", subject, 3, "")
        elif shape.tag in _SIZES:
            size = np.array([tree.number(shape, key, subject, None) for key in _SIZES[shape.tag]])
        else:
            raise RobotError(
                f"URDF {tree.path}: {subject} is a <{shape.tag}>; box, sphere, cylinder, capsule or mesh is expected"
            )
        allowed = (size > 0.0) & (size <= LARGEST)
    if not allowed.all():
        raise RobotError(
            f"URDF {tree.path}: {subject} is a {shape.tag} of size {' '.join(f'{value:g}' for value in size)}; "
            f"numbers greater than zero, and at most {LARGEST:g}, are expected"
        )
    return Visual(
        name=link,
        shape=shape.tag,  # type: ignore[arg-type]
        size=tuple(map(float, size)),
        rotation=rotation,
        translation=translation,
        color=color,
        mesh=mesh,
    )


def _mesh_path(tree: UrdfTree, text: str, subject: str) -> Path:
    """Return the path of a mesh. Raises RobotError if no package contains the file.

    A package is a folder above the URDF, a folder beside one of these, or a folder in the
    environment variable ROS_PACKAGE_PATH.
    """
    if not text or "\0" in text:
        raise RobotError(f"URDF {tree.path}: {subject} is a mesh without a file name")
    scheme, separator, rest = text.partition("://")
    if not separator:
        return tree.path.parent / text
    if scheme == "file":
        return Path(rest)
    package, _, inside = rest.partition("/")
    if scheme in ("package", "model"):
        above = list(tree.path.absolute().parents)
        found = [Path(part) for part in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)]
        folders = [folder for folder in above if folder.name == package]
        for folder in (*folders, *(root / package for root in (*above, *found))):
            if os.path.isfile(folder / inside):
                return folder / inside
    raise RobotError(
        f"URDF {tree.path}: {subject} is the mesh {text}, which is not found; give a file name relative to the URDF, "
        f"or the folder above its package in ROS_PACKAGE_PATH"
    )
