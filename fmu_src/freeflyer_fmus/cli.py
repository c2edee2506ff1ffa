"""Command `freeflyer fmus`: build the FMUs of a robot or of a user-defined block."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from freeflyer_fmus.blocks.shipped import BLOCKS
from freeflyer_fmus.blocks.user_block import load_block
from freeflyer_fmus.equations.pinocchio_reference import disagreement
from freeflyer_fmus.errors import FmuSourceError, RobotError
from freeflyer_fmus.export.archive import build_all
from freeflyer_fmus.export.compiler import PLATFORMS, Platform, host_platform
from freeflyer_fmus.robot.robot import Robot
from freeflyer_fmus.robot.urdf import (
    DEFAULT_ROBOT,
    load_robot_file,
    load_urdf,
    robot_path,
    shipped_robots,
)

SOURCES = "sources"
"""Name in --platforms that adds the C sources, for importers that compile an FMU themselves."""
AGREEMENT = 1e-8
"""Largest accepted relative difference between the forward dynamics and Pinocchio's result.

Only a robot that is selected with --robot is checked.
"""


class FmusCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        # The robot: links, locked joints and start posture.
        parser.add_argument(
            "--robot",
            metavar="FILE",
            help=f"a .urdf, a robot file .toml, or a shipped robot: {', '.join(shipped_robots())} (default: {DEFAULT_ROBOT.stem})",
        )
        parser.add_argument(
            "--base-link",
            metavar="L",
            help="link of the floating base (default: the root of the URDF)",
        )
        parser.add_argument(
            "--end-effector",
            metavar="L",
            help="link of the end-effector (default: the only link without children)",
        )
        parser.add_argument(
            "--tool-link",
            metavar="L",
            help="link whose mass and inertia become FMU parameters (default: none)",
        )
        parser.add_argument(
            "--lock",
            action="append",
            default=[],
            metavar="JOINT=VALUE",
            help="fix a joint at VALUE [rad or m]; can be given several times",
        )
        parser.add_argument(
            "--posture",
            nargs="+",
            metavar="JOINT=VALUE",
            help="start posture: JOINT=VALUE for each free joint, or one number for each free joint",
        )
        # The block, and the files to write.
        parser.add_argument(
            "--block",
            type=Path,
            metavar="FILE.py",
            help="Python file that defines the function block(robot) -> Block",
        )
        parser.add_argument(
            "--platforms",
            default="host",
            help=f"host (default), all, or a list of {', '.join((*PLATFORMS, SOURCES))}",
        )
        parser.add_argument("--out", type=Path, default=Path("fmus"), metavar="DIR")

    def execute(self, arguments: argparse.Namespace, console: Any) -> int:
        try:
            return self._build(arguments, console)
        except FmuSourceError as error:
            print(f"freeflyer: {error}", file=sys.stderr)
            return 2

    def _build(self, arguments: argparse.Namespace, console: Any) -> int:
        platforms, sources = chosen_platforms(arguments.platforms)
        arguments.robot = None if arguments.robot is None else robot_path(arguments.robot)
        robot = chosen_robot(arguments)
        makers = (
            BLOCKS
            if arguments.block is None
            else {arguments.block.stem: load_block(arguments.block)}
        )
        # Declare and check every block before the first file is written.
        blocks = [make(robot) for make in makers.values()]
        for block in blocks:
            _ = block.functions
        if arguments.robot is not None:
            difference = disagreement(robot)
            if not difference < AGREEMENT:
                raise RobotError(
                    f"robot {robot.name}: the generated forward dynamics differ from Pinocchio's by {difference:.1e}, but less than "
                    f"{AGREEMENT:g} is expected: choose inertias that differ less in magnitude"
                )
            console.print(
                f"{robot.name}: {robot.joint_count} free joints; dynamics agree with Pinocchio's (relative difference {difference:.1e})"
            )
        with console.status(
            f"compiling {len(blocks)} blocks for {', '.join(p.fmi3 for p in platforms) or 'no platform'}"
        ):
            for block, paths in build_all(blocks, arguments.out, platforms, sources=sources):
                console.print(
                    f"{block.name}: {', '.join(str(path) for path in paths.values())}",
                    soft_wrap=True,
                )
        return 0


def chosen_platforms(text: str) -> tuple[list[Platform], bool]:
    """Return the platforms to compile for, and whether to add the C sources to the FMUs."""
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


def chosen_robot(arguments: argparse.Namespace) -> Robot:
    """Load the robot that the command line selects.

    Raises RobotError if an option for a URDF is given with another kind of robot.
    """
    lock = dict(assignment(text, "--lock") for text in arguments.lock)
    posture = posture_of(arguments.posture)
    given = [arguments.base_link, arguments.end_effector, arguments.tool_link, posture, *lock]
    if arguments.robot is None or arguments.robot.suffix == ".toml":
        if any(value is not None for value in given):
            raise RobotError(
                "--base-link, --end-effector, --tool-link, --lock and --posture apply only to a URDF; select a URDF file with --robot"
            )
        return load_robot_file(arguments.robot) if arguments.robot else load_robot_file()
    return load_urdf(
        arguments.robot,
        base_link=arguments.base_link,
        end_effector=arguments.end_effector,
        tool_link=arguments.tool_link,
        lock=lock,
        posture=posture,
    )


def assignment(text: str, option: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError as error:
        raise RobotError(
            f"{option} {text}: JOINT=VALUE with a number is expected, for example {name}=0.5"
        ) from error


def posture_of(texts: Sequence[str] | None) -> dict[str, float] | list[float] | None:
    if texts is None:
        return None
    if any("=" in text for text in texts):
        return dict(assignment(text, "--posture") for text in texts)
    try:
        return [float(text) for text in texts]
    except ValueError as error:
        raise RobotError(
            f"--posture {' '.join(texts)}: numbers, or JOINT=VALUE for each joint, are expected"
        ) from error
