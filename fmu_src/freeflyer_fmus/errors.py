"""Exceptions of this package. Every message is one sentence for the user."""

from __future__ import annotations

from freeflyer.foundation.errors import CosimError


class FmuSourceError(CosimError):
    """Base class of this package's exceptions."""


class RobotError(FmuSourceError):
    """Raised if a robot description is malformed or physically impossible."""


class BlockError(FmuSourceError):
    """Raised if the variables and equations of a block are inconsistent."""


class BuildError(FmuSourceError):
    """Raised if the C compiler or the packaging fails."""
