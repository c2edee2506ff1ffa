"""Errors between a URDF and an FMU; every message is one sentence for the user."""

from __future__ import annotations


class FmuSourceError(Exception):
    """Base of this package's errors."""


class RobotError(FmuSourceError):
    """A robot description that is malformed or physically impossible."""


class BlockError(FmuSourceError):
    """A block whose variables and equations are inconsistent."""


class BuildError(FmuSourceError):
    """The C compiler or the packaging failed."""
