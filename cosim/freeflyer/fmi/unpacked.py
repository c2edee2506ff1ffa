"""Folders that FMUs are unpacked into: one for each instance at a time, whatever else its library or its Python keeps there."""

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
"""Which version of which file a folder in use, that may be used again, was unpacked from."""
_place: Path | None = None
"""Where folders are kept for the next instance of the same file; None: nowhere."""


@contextmanager
def kept_in(place: Path) -> Iterator[None]:
    """Meanwhile folders that our own FMUs gave back are handed out again; all are inside `place`, which its owner removes.

    FMUs of others always get a folder of their own: what they leave there, or in the library's memory, is not known.
    """
    global _place
    before, _place = _place, place
    try:
        yield
    finally:
        _place = before


def take(path: Path) -> Path:
    """A folder with the FMU's contents, which nobody else uses; nothing of it is run. OSError if it cannot be written, ComponentError
    if the FMU is refused.
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
    """After the instance is freed."""
    version = _of.pop(folder, None)
    if version is not None and _place is not None:
        _free.setdefault(version, []).append(folder)
    else:
        remove(folder)


def remove(folder: Path) -> None:
    _of.pop(folder, None)
    shutil.rmtree(folder, ignore_errors=True)
