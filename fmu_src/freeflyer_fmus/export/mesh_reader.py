"""Program that reads mesh files with Pinocchio's geometry library, as a process of its own.

The library allocates as much memory as a damaged file demands, and can crash. For each file that
is named on the standard input, the program writes NUMBER.npz into the folder that is its argument.
"""

from __future__ import annotations

import contextlib
import resource
import sys
from pathlib import Path

import coal
import numpy as np

MOST_MEMORY = 4 << 30
"""Largest address space of the process [bytes]."""


def read(path: str, target: Path) -> None:
    try:
        model = coal.MeshLoader().load(path, np.ones(3))
        vertices = np.array(model.vertices(), dtype=np.float64).reshape(-1, 3)
        rows = [model.tri_indices(index) for index in range(model.num_tris)]
    except Exception:  # the library raises several types
        vertices, rows = np.zeros((0, 3)), []
    triangles = np.array([(row[0], row[1], row[2]) for row in rows], dtype=np.int64)
    partial = target.with_suffix(".partial")
    with partial.open("wb") as file:
        np.savez(file, vertices=vertices, triangles=triangles.reshape(-1, 3))
    partial.rename(target)


if __name__ == "__main__":
    with contextlib.suppress(ValueError, OSError):  # an operating system without this limit
        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    for number, path in enumerate(sys.stdin.buffer.read().split(b"\0")):
        read(path.decode(errors="surrogateescape"), Path(sys.argv[1]) / f"{number}.npz")
