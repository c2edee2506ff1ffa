"""FMUs of the free-flyer: robot, equations, blocks, export.

The public names are listed in `__all__` and declared in __init__.pyi. A name is loaded when it is
first used. All modules are private, so their paths may change.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
