"""Loading of user-defined blocks from Python files."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path

from freeflyer.foundation.plugins import renamed
from freeflyer_fmus.blocks.block import Block
from freeflyer_fmus.errors import BlockError, FmuSourceError
from freeflyer_fmus.robot.robot import Robot


def load_block(path: Path) -> Callable[[Robot], Block]:
    """Load the function `block` of a user's file.

    Raises BlockError if the file or the function fails, or if the result is not a Block.
    """
    if not path.is_file():
        raise BlockError(f"block file {path} does not exist")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        made: Callable[[Robot], Block] = module.block
    except (Exception, SystemExit) as error:  # third-party code: any error is possible
        raise BlockError(
            f"block file {path} does not define block(robot): {type(error).__name__}: {error}{renamed(error)}"
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
                f"block file {path}: block(robot) failed: {type(error).__name__}: {' '.join(str(error).split())}{renamed(error)}"
            ) from error
        if not isinstance(block, Block):
            raise BlockError(
                f"block file {path}: block(robot) returned a {type(block).__name__}; a Block is expected"
            )
        return block

    return make
