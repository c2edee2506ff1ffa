"""Multi-rate co-simulation of a free-flying space robot: scenarios, master, records, analysis.

__init__.pyi declares the public names. A name is imported when it is used for the first time. All
modules are private and may be moved.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
