"""Alias of the names with which a user's file defines a block: `freeflyer_fmus.Block`."""

from freeflyer_fmus.blocks.block import WRENCH, Block

__all__ = ["WRENCH", "Block"]
