"""Where the FMUs are that were built when this package was installed."""

from __future__ import annotations

from pathlib import Path


def directory() -> Path:
    """Holds fmi2/NAME.fmu and fmi3/NAME.fmu."""
    return Path(__file__).parent.parent / "prebuilt"
