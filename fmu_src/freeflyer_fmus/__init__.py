"""FMUs of the free-flyer: robot, equations, blocks, export.

The public names are listed in `__all__` and declared in __init__.pyi. A name is loaded when it is
first used. All modules are private, so their paths may change.
"""

import lazy_loader

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name):
    """Return a public name. Raises MissingExtra if it needs an extra that is not installed."""
    from freeflyer.foundation.extras import needed_by

    with needed_by(f"{__name__}.{name}"):
        return _attribute(name)
