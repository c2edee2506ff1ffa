from .blocks.block import WRENCH as WRENCH
from .blocks.block import Block as Block
