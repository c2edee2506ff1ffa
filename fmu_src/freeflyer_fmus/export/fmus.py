"""Export the blocks of a robot as FMUs."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from freeflyer.foundation.errors import OutputError
from freeflyer.foundation.output_file import check_writable
from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.blocks.user_block import load_block
from freeflyer_fmus.equations.pinocchio_reference import disagreement
from freeflyer_fmus.errors import BuildError, FmuSourceError, RobotError
from freeflyer_fmus.export.archive import Progress, build_all
from freeflyer_fmus.export.compiler import PLATFORMS, Platform, host_platform
from freeflyer_fmus.robot.robot import Robot
from freeflyer_fmus.robot.urdf import load_robot

SOURCES = "sources"
"""Name among the platforms that adds the C sources, for importers that compile FMUs themselves."""
AGREEMENT = 1e-8
"""Largest accepted relative difference between the forward dynamics and Pinocchio's result."""


def check_dynamics(robot: Robot) -> float:
    """Return the relative difference of the generated forward dynamics from Pinocchio's.

    Raises RobotError if the difference is above AGREEMENT.
    """
    difference = disagreement(robot)
    if not difference < AGREEMENT:
        raise RobotError(
            f"robot {robot.name}: the generated forward dynamics differ from Pinocchio's by {difference:.1e}, but less than "
            f"{AGREEMENT:g} is expected: choose inertias that differ less in magnitude"
        )
    return difference


def chosen_platforms(text: str) -> tuple[list[Platform], bool]:
    """Return the platforms to compile for, and whether to add the C sources to the FMUs.

    Raises FmuSourceError for an unknown name.
    """
    chosen: dict[str, Platform] = {}
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name == "all":
            chosen |= PLATFORMS
        elif name == "host":
            chosen[host_platform().fmi3] = host_platform()
        elif name in PLATFORMS:
            chosen[name] = PLATFORMS[name]
        elif name != SOURCES:
            raise FmuSourceError(
                f"--platforms {text}: {name!r} is not one of {', '.join((*PLATFORMS, SOURCES))}, host, all"
            )
    return list(chosen.values()), SOURCES in names or "all" in names


def export_fmus(
    directory: str | os.PathLike[str],
    robot: Robot | None = None,
    block: Block | str | os.PathLike[str] | None = None,
    *,
    platforms: str | Sequence[str] = "host",
    progress: Progress | None = None,
) -> dict[str, dict[int, Path]]:
    """Build FMUs into `directory`, and return their paths: {"free_flyer": {2: ..., 3: ...}}.

    The keys of the inner mapping are the FMI versions. `robot` is a result of `load_robot`
    (default: the LWR 4+ with six joints). `block` is one block, or a file FILE.py with the function
    block(robot) -> Block (default: all shipped blocks). `platforms` is a list of names, or a text
    with names separated by commas: host, all, sources, or those of docs/fmus.md. `progress` is
    called with the number of compiled libraries, the number of all libraries, and what is compiled
    now ("free_flyer for x86_64-linux"). Raises FmuSourceError, also if the dynamics of `robot`
    differ from Pinocchio's.
    """
    if robot is not None:
        check_dynamics(robot)
    names = platforms if isinstance(platforms, str) else ",".join(platforms)
    made = exported(directory, robot, block, names, progress)
    return {each.name: paths for each, paths in made}


def exported(
    directory: str | os.PathLike[str],
    robot: Robot | None,
    block: Block | str | os.PathLike[str] | None,
    platforms: str,
    progress: Progress | None = None,
) -> Iterator[tuple[Block, dict[int, Path]]]:
    """Yield each block with its paths, as soon as it is built. See `export_fmus`."""
    chosen, sources = chosen_platforms(platforms)
    try:
        check_writable(Path(directory))
    except OutputError as error:
        raise BuildError(str(error)) from error
    if isinstance(block, Block):
        blocks = [block]
    else:
        makers = BLOCKS.values() if block is None else [load_block(Path(block))]
        blocks = [make(robot or load_robot()) for make in makers]
    for each in blocks:  # check every block before the first file is written
        _ = each.functions
    yield from build_all(blocks, Path(directory), chosen, sources=sources, progress=progress)
