"""Hardware in the loop: devices, links, the loop in real time, recordings, virtual facility.

Public names are those of `__all__`, declared in __init__.pyi and loaded when first used. Every
module is private and may move.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
