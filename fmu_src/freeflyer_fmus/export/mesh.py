"""Triangles and colors of a mesh file (STL, Collada, OBJ), reduced where the file has too many.

Pinocchio's geometry library reads the triangles, in a process of its own. It returns no colors.
Therefore the colors of a Collada file are read from its XML.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from freeflyer.foundation import bounded_file
from freeflyer.foundation.errors import CosimError
from freeflyer.foundation.extras import require
from freeflyer_fmus.errors import RobotError
from freeflyer_fmus.robot.visual import LARGEST, Color

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
LARGEST_FILE = 64 << 20
"""Largest size of a mesh file [bytes]. A binary STL file of this size has 1.3 million triangles."""

LONGEST_TIME = 120.0
"""Longest time in which the files of a robot are read [s]."""
READER = Path(__file__).parent / "mesh_reader.py"


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """Part of a mesh with one color: `vertices` (m, 3) [m], `triangles` (k, 3) of their indices."""

    vertices: Array
    triangles: Indices
    color: Color | None = None


def read_meshes(paths: Iterable[Path]) -> dict[Path, Part | CosimError]:
    """Read mesh files. The result has one part for each file, or the reason why there is none.

    A reason is MissingExtra if the extra `export` is not installed, and else RobotError.
    """
    read: dict[Path, Part | CosimError] = {}
    for path in paths:
        try:
            _check_size(path)
            require(f"mesh {path}", ["coal"])
        except CosimError as error:
            read[path] = error
    pending, end = [path for path in paths if path not in read], time.monotonic() + LONGEST_TIME
    while pending:
        if (left := end - time.monotonic()) <= 0.0:
            late = (
                f"is not read, because the meshes of this robot take more than {LONGEST_TIME:g} s"
            )
            return read | {path: RobotError(f"mesh {path} {late}") for path in pending}
        found = _read_in_process(pending, left)
        for path, part in zip(pending, found, strict=False):
            read[path] = part or RobotError(f"mesh {path} is not a valid STL, Collada or OBJ file")
        pending = pending[len(found) :]
    return read


def _check_size(path: Path) -> None:
    try:
        with bounded_file.opened(path) as file:
            count = file.seek(0, 2)
    except OSError as error:
        raise RobotError(f"mesh {path} cannot be read: {error.strerror}") from error
    if count > LARGEST_FILE:
        raise RobotError(
            f"mesh {path} has {bounded_file.size(count)}, but at most {bounded_file.size(LARGEST_FILE)} are expected: reduce the number of its triangles"
        )


def _read_in_process(paths: list[Path], longest: float) -> list[Part | None]:
    """Read the first of these files, up to a file at which the process fails: it has no part.

    The process is stopped after `longest` seconds.
    """
    with tempfile.TemporaryDirectory() as folder:
        with contextlib.suppress(subprocess.TimeoutExpired):
            subprocess.run(
                [sys.executable, "-P", str(READER), folder],
                input=b"\0".join(os.fsencode(path.absolute()) for path in paths),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=longest,
                check=False,
            )
        parts: list[Part | None] = []
        for number in range(len(paths)):
            file = Path(folder) / f"{number}.npz"
            if not file.is_file():
                return [*parts, None]
            with np.load(file) as arrays:
                part = Part(vertices=arrays["vertices"], triangles=arrays["triangles"])
            parts.append(part if len(part.triangles) else None)
    return parts


def drawable(
    path: Path, whole: Part, scale: tuple[float, ...], most: int, *, colored: bool
) -> list[Part]:
    """Return the parts of a mesh with about `most` triangles or fewer, one part for each color.

    `whole` is the content of the file `path`. Its coordinates are multiplied by `scale` (3). The
    colors are those of the file if `colored` is True; else there is one part. Raises RobotError if
    a coordinate cannot be drawn.
    """
    vertices, triangles = whole.vertices * np.array(scale), whole.triangles
    if not (np.abs(vertices) <= LARGEST).all():
        raise RobotError(
            f"mesh {path} has a coordinate that is not a number or is above {LARGEST:g} m; correct the mesh or its scale"
        )
    if np.prod(scale) < 0.0:  # a mirrored triangle would show its back
        triangles = triangles[:, ::-1]
    colors = _collada_colors(path) if colored and path.suffix.lower() == ".dae" else []
    ends = _ends(triangles, [number for number, _ in colors])
    owner = np.searchsorted(ends, np.arange(len(triangles)), side="right")
    found = [color for _, color in colors] if ends else [None]
    groups = {
        color: triangles[np.isin(owner, [k for k, other in enumerate(found) if other == color])]
        for color in dict.fromkeys(found)
    }
    # Small parts need less than their share, and leave the rest to the larger parts.
    parts = []
    for index, (color, own) in enumerate(sorted(groups.items(), key=lambda item: len(item[1]))):
        part = _reduced(vertices, own, most // (len(groups) - index), color)
        most -= len(part.triangles)
        if len(part.triangles):
            parts.append(part)
    return parts


def _ends(triangles: Indices, counts: list[int]) -> list[int]:
    """Return the index after the last triangle of each group. `counts` are the groups in the file.

    The library omits a few degenerate triangles. Most groups have no common vertices, and the
    indices of the vertices increase from group to group. This shows where such a group ends. The
    list is empty if the counts do not fit.
    """
    lost = sum(counts) - len(triangles)
    if not 0 <= lost <= 0.01 * len(triangles):
        return []
    highest = np.maximum.accumulate(triangles.max(axis=1))[:-1]
    lowest = np.minimum.accumulate(triangles.min(axis=1)[::-1])[::-1][1:]
    possible = np.append(np.flatnonzero(highest < lowest) + 1, len(triangles))
    ends: list[int] = []
    omitted = 0
    for end in np.cumsum(counts):
        near = possible[(possible >= end - lost) & (possible <= end - omitted)]
        ends.append(int(near[-1] if len(near) else end - omitted))
        omitted = int(end) - ends[-1]
    return ends


def _collada_colors(path: Path) -> list[tuple[int, Color | None]]:
    """Return number of triangles and color of each group of triangles, in the order of the scene.

    The list is empty if the file cannot be interpreted.
    """
    try:
        root = ElementTree.parse(path).getroot()
        for element in root.iter():  # remove the namespace
            element.tag = str(element.tag).rpartition("}")[2]
        diffuse = {}
        for effect in root.iter("effect"):
            text = effect.findtext(".//diffuse/color") or ""
            red, green, blue, *_ = (*map(float, text.split()), *[0.75] * 3)
            diffuse["#" + effect.get("id", "")] = (red, green, blue, 1.0)
        effects = {
            "#" + material.get("id", ""): instance.get("url", "")
            for material in root.iter("material")
            if (instance := material.find("instance_effect")) is not None
        }
        groups = {
            "#" + geometry.get("id", ""): [
                (_triangle_count(group), group.get("material"))
                for group in geometry.findall("mesh/*")
                if group.tag in ("triangles", "polylist")
            ]
            for geometry in root.iter("geometry")
        }
        colors: list[tuple[int, Color | None]] = []
        for instance in root.iter("instance_geometry"):
            target = {m.get("symbol"): m.get("target", "") for m in instance.iter("instance_material")}  # fmt: skip
            for count, symbol in groups.get(instance.get("url", ""), []):
                color = diffuse.get(effects.get(target.get(symbol, ""), ""))
                within = color is not None and all(0.0 <= part <= 1.0 for part in color)
                colors.append((count, color if within else None))
    except (OSError, ValueError, ElementTree.ParseError):
        return []
    return colors


def _triangle_count(group: ElementTree.Element) -> int:
    if group.tag == "triangles":
        return int(group.get("count", "0"))
    return sum(int(corners) - 2 for corners in (group.findtext("vcount") or "").split())


def _reduced(vertices: Array, triangles: Indices, most: int, color: Color | None) -> Part:
    """Return a mesh of at most `most` triangles that has nearly the same surface.

    The vertices of a connected surface that are in one cell of a grid become one vertex. The number
    of cells is the largest that gives few enough triangles. The new vertex has the smallest sum of
    squared distances to the planes of the triangles around it, which keeps edges sharp (Lindstrom,
    Out-of-core simplification of large polygonal models, SIGGRAPH 2000).
    """
    points, inverse = np.unique(vertices[triangles.ravel()], axis=0, return_inverse=True)
    triangles = inverse.reshape(-1, 3)
    if len(triangles) > most:
        links = coo_array(
            (np.ones(2 * len(triangles)), (triangles[:, [0, 1]].ravel(), triangles[:, [1, 2]].ravel())),
            shape=(len(points), len(points)),
        )  # fmt: skip
        _, surface = connected_components(links, directed=False)
        extent = float(np.ptp(points, axis=0).max()) or 1.0
        few, many = 1, 4096  # bounds of the number of cells along the longest edge
        while many - few > 1:
            middle = (few + many) // 2
            _, kept = _clustered(points, surface, triangles, extent / middle)
            few, many = (middle, many) if len(kept) <= most else (few, middle)
        cells, kept = _clustered(points, surface, triangles, extent / few)
        if 4 * len(kept) < most:  # separate triangles: each of them would become a point
            area = np.linalg.norm(
                np.cross(*np.diff(points[triangles], axis=1).swapaxes(0, 1)), axis=1
            )
            kept = triangles[np.argsort(area)[len(area) - most :]]
        else:
            points = _representatives(points, triangles, cells, extent / few)
        used, corners = np.unique(kept, return_inverse=True)
        points, triangles = points[used], corners.reshape(-1, 3)
    return Part(vertices=points, triangles=triangles, color=color)


def _clustered(
    points: Array, surface: Indices, triangles: Indices, cell: float
) -> tuple[Indices, Indices]:
    """Return the cluster of each point, and the different triangles between different clusters."""
    grid = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    _, cells = np.unique(_key(_key(grid[:, 0], grid[:, 1]), grid[:, 2]), return_inverse=True)
    _, cells = np.unique(_key(surface, cells), return_inverse=True)
    corners = cells[triangles]
    a, b, c = corners.T
    corners = corners[(a != b) & (b != c) & (c != a)]
    # Triangles are equal if they have the same corners in the same cyclic order.
    first = np.argmin(corners, axis=1)[:, None]
    corners = np.take_along_axis(corners, (first + np.arange(3)) % 3, axis=1)
    a, b, c = corners.T
    _, different = np.unique(_key(_key(a, b), c), return_index=True)
    return cells, corners[different]


def _key(first: Indices, second: Indices) -> Indices:
    """Return one integer for each pair of integers. Two pairs with the same integer are equal."""
    return first * (int(second.max(initial=0)) + 1) + second


def _representatives(points: Array, triangles: Indices, cells: Indices, cell: float) -> Array:
    """Return one point for each cluster: the minimum of its quadric, near the mean."""
    count = int(cells.max()) + 1
    number = np.bincount(cells, minlength=count)[:, None]
    mean = np.stack([np.bincount(cells, part, count) for part in points.T], axis=1) / number
    # Each triangle adds its squared distance, times its area, to the clusters of its corners.
    p, q, r = (points[triangles[:, k]] for k in range(3))
    normal = np.cross(q - p, r - p)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.maximum(length, 1e-300)
    outer = normal[:, :, None] * normal[:, None, :] * length[:, :, None]
    A, b = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for k in range(3):
        home = cells[triangles[:, k]]
        offset = np.einsum("tij,tj->ti", outer, p - mean[home])
        for i in range(3):
            b[:, i] += np.bincount(home, offset[:, i], count)
            for j in range(3):
                A[:, i, j] += np.bincount(home, outer[:, i, j], count)
    # The small multiple of the identity keeps the point near the mean along a flat surface.
    A += (1e-2 * np.trace(A, axis1=1, axis2=2) + 1e-300)[:, None, None] * np.eye(3)
    step = np.linalg.solve(A, b[:, :, None])[:, :, 0]
    distance = np.linalg.norm(step, axis=1, keepdims=True)
    moved: Array = mean + step * np.minimum(1.0, 0.7 * cell / np.maximum(distance, 1e-300))
    return moved
