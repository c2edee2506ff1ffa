"""FMUs of the free-flyer: robot, equations, blocks, export.

The public names are those in `__all__`. __init__.pyi declares them; they are loaded on first use.
All modules are private and may move.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
