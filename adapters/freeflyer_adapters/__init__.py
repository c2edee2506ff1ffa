"""Hardware in the loop: devices, links, the loop in real time, recordings, virtual facility.

Public names are those of `__all__`, declared in __init__.pyi and loaded when first used. Every
module is private and may move.
"""

import lazy_loader

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name):
    """Return a public name. Raises MissingExtra if it needs an extra that is not installed."""
    from freeflyer.foundation.extras import needed_by

    with needed_by(f"{__name__}.{name}"):
        return _attribute(name)
