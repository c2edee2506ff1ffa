from .block import WRENCH as WRENCH
from .block import Block as Block
