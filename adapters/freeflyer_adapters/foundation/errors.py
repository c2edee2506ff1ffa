"""Exceptions of devices and links."""

from __future__ import annotations

from freeflyer.foundation.errors import CosimError


class DeviceError(CosimError):
    """A device cannot be configured or activated."""
