"""Folders into which FMUs are unpacked. Each instance has a folder that no other instance uses."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from freeflyer.fmi.fmu_description import OWN_TOOL, describe_fmu, opened, same_file

Version = tuple[Path, tuple[int, ...]]
_free: dict[Version, list[Path]] = {}
_of: dict[Path, Version] = {}
"""For each reusable folder that is in use: the FMU file and the version of this file."""
_place: Path | None = None
"""Directory in which folders are kept for the next instance of the same FMU file.

If it is None, each folder is removed after use.
"""


@contextmanager
def kept_in(place: Path) -> Iterator[None]:
    """Keep the folders of our own FMUs in `place` for reuse. The caller removes `place`.

    Each instance of a third-party FMU gets a new folder. Such an FMU may store state in the folder
    or in the memory of its library.
    """
    global _place
    before, _place = _place, place
    try:
        yield
    finally:
        _place = before


def take(path: Path) -> Path:
    """Return a folder with the FMU's contents for one instance. Nothing in the FMU is executed.

    Raises OSError if the folder cannot be written, ComponentError if the FMU is rejected.
    """
    again = _place is not None and describe_fmu(path).generationTool == OWN_TOOL
    version = (path, same_file(path))
    folder = _kept(version) if again else None
    if folder is None:
        folder = Path(tempfile.mkdtemp(prefix="freeflyer-", dir=_place))
        try:
            with opened(path) as archive:
                archive.extract_all(folder)
        except BaseException:
            remove(folder)
            raise
    if again:
        _of[folder] = version
    return folder


def _kept(version: Version) -> Path | None:
    free = _free.get(version, [])
    while free:
        folder = free.pop()
        if folder.is_dir():
            return folder
    return None


def give_back(folder: Path) -> None:
    """Make a folder available for reuse, or remove it. Call this after the instance is freed."""
    version = _of.pop(folder, None)
    if version is not None and _place is not None:
        _free.setdefault(version, []).append(folder)
    else:
        remove(folder)


def remove(folder: Path) -> None:
    """Delete a folder that must not be used again."""
    _of.pop(folder, None)
    shutil.rmtree(folder, ignore_errors=True)
