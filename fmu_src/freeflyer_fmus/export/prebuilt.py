"""Location of the FMUs built at installation."""

from __future__ import annotations

from pathlib import Path

from freeflyer_fmus.errors import FmuSourceError


def directory() -> Path:
    """Return the directory that contains fmi2/NAME.fmu and fmi3/NAME.fmu."""
    return Path(__file__).parent.parent / "prebuilt"


def fmu_path(name: str, *, fmi: int = 2) -> Path:
    """Return the path of the shipped FMU `name`, for another master. `fmi` is its FMI version.

    `fmi` is 2 or 3. Raises FmuSourceError if there is no such FMU.
    """
    path = directory() / f"fmi{fmi}" / f"{name}.fmu"
    if not path.is_file():
        known = sorted(file.stem for file in (directory() / "fmi2").glob("*.fmu"))
        raise FmuSourceError(
            f"there is no FMU {name!r} of FMI {fmi}; FMI 2 or 3 is expected, and one of {', '.join(known)}"
        )
    return path
