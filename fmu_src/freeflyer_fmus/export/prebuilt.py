"""Location of the FMUs built at installation."""

from __future__ import annotations

from pathlib import Path


def directory() -> Path:
    """Return the directory that contains fmi2/NAME.fmu and fmi3/NAME.fmu."""
    return Path(__file__).parent.parent / "prebuilt"
