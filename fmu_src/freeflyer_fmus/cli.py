"""Command `freeflyer fmus`: build the FMUs of a robot or of a user-defined block."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from freeflyer.foundation.extras import require
from freeflyer.foundation.output_file import folder
from freeflyer_fmus.errors import RobotError
from freeflyer_fmus.export.compiler import PLATFORMS
from freeflyer_fmus.export.fmus import (
    SOURCES,
    check_dynamics,
    chosen_platforms,
    exported,
)
from freeflyer_fmus.export.scene import scene
from freeflyer_fmus.robot.urdf import DEFAULT_ROBOT, load_robot, shipped_robots


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
        parser.add_argument("--out", type=folder, default=Path("fmus"), metavar="DIR")

    def execute(self, arguments: argparse.Namespace, console: Any) -> int:
        platforms, _ = chosen_platforms(arguments.platforms)
        # Report a missing package before the equations are derived, which takes seconds.
        if platforms:
            require("freeflyer fmus", ["ziglang"])
        if arguments.robot is not None:
            require("freeflyer fmus --robot", ["pinocchio"])
        robot = load_robot(
            DEFAULT_ROBOT.stem if arguments.robot is None else arguments.robot,
            base_link=arguments.base_link,
            end_effector=arguments.end_effector,
            tool_link=arguments.tool_link,
            lock=dict(assignment(text, "--lock") for text in arguments.lock),
            posture=posture_of(arguments.posture),
        )
        if arguments.robot is not None:
            console.print(
                f"{robot.name}: {robot.joint_count} free joints; dynamics agree with Pinocchio's (relative difference {check_dynamics(robot):.1e})"
            )
        columns = (TextColumn("{task.description}", markup=False), BarColumn())
        with Progress(
            *columns,
            MofNCompleteColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        ) as bar:
            task = bar.add_task("equations", total=None)

            def show(finished: int, total: int, name: str) -> None:
                bar.update(task, completed=finished, total=total, description=name)

            for block, paths in exported(
                arguments.out, robot, arguments.block, arguments.platforms, show
            ):
                console.print(
                    f"{block.name}: {', '.join(str(path) for path in paths.values())}",
                    soft_wrap=True,
                )
        for note in scene(robot)["notes"]:
            console.print(f"note: {note}", soft_wrap=True)
        return 0


def assignment(text: str, option: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError as error:
        raise RobotError(
            f"{option} {text}: JOINT=VALUE with a number is expected, for example {name or 'JOINT'}=0.5"
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
