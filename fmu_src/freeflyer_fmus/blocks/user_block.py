"""Loading of user-defined blocks from Python files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from freeflyer.foundation.plugins import described
from freeflyer.foundation.user_object import loaded
from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.errors import BlockError, FmuSourceError
from freeflyer_fmus.robot.robot import Robot


def load_block(path: Path) -> Callable[[Robot], Block]:
    """Load the function `block` of a user's file.

    Raises BlockError if the file or the function fails, or if the result is not a Block.
    """
    if not path.is_file():
        raise BlockError(f"block file {path} does not exist")
    try:
        made: Callable[[Robot], Block] = loaded(path).block
    except (Exception, SystemExit) as error:  # third-party code: any error is possible
        raise BlockError(
            f"block file {path} does not define block(robot): {described(error)}"
        ) from error

    def make(robot: Robot) -> Block:
        try:
            block = made(robot)
            if isinstance(block, Block):
                _ = block.functions  # derives the equations, so that their errors occur here
        except FmuSourceError:
            raise
        except (Exception, SystemExit) as error:
            raise BlockError(
                f"block file {path}: block(robot) failed: {described(error)}"
            ) from error
        if not isinstance(block, Block):
            raise BlockError(
                f"block file {path}: block(robot) returned a {type(block).__name__}; a Block is expected"
            )
        return block

    return make
