"""Multi-rate co-simulation of a free-flying space robot: scenarios, master, records, analysis.

__init__.pyi declares the public names. A name is imported when it is used for the first time. All
modules are private and may be moved.
"""

import lazy_loader

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name):
    """Return a public name. Raises MissingExtra if it needs an extra that is not installed."""
    from freeflyer.foundation.extras import needed_by

    with needed_by(f"{__name__}.{name}"):
        return _attribute(name)
