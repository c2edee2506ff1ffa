"""Folders into which FMUs are unpacked.

Each instance of an FMU has its own folder. While the instance exists, no other instance uses this
folder. A later instance of the same FMU may reuse the folder.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from freeflyer.fmi.fmu_description import describe_fmu, opened, same_file
from freeflyer.foundation.own_fmus import OWN_TOOL
from freeflyer.foundation.temporary_folder import TemporaryFolder

Version = tuple[Path, tuple[int, ...]]
"""The path of an FMU file, and the result of `same_file` for this file."""
_free: dict[Version, list[Path]] = {}
_of: dict[Path, Version] = {}
"""For each reusable folder that an instance uses: the version of the FMU file."""
_temporary: dict[Path, TemporaryFolder] = {}
"""The folders that are not in `_place`."""
_place: Path | None = None
"""Directory in which folders are kept for later instances of the same FMU file.

If `_place` is None, no folder is reused, and each folder is removed after use.
"""


@contextmanager
def kept_in(place: Path) -> Iterator[None]:
    """Keep the folders of our own FMUs in the directory `place`, so that they can be reused.

    The caller removes `place` afterwards. Folders of other FMUs are not reused. Such an FMU may
    store state in its folder, or in the memory of the library that is loaded from this folder.
    """
    global _place
    before, _place = _place, place
    try:
        yield
    finally:
        _place = before


def take(path: Path) -> Path:
    """Return a folder for one instance. The folder contains the unpacked FMU file `path`.

    Nothing in the FMU is executed.
    Raises OSError if the folder cannot be written, ComponentError if the FMU is rejected, and
    CosimError if there is no temporary directory.
    """
    again = _place is not None and describe_fmu(path).generationTool == OWN_TOOL
    version = (path, same_file(path))
    folder = _kept(version) if again else None
    if folder is None:
        if _place is not None:
            folder = Path(tempfile.mkdtemp(dir=_place))
        else:
            temporary = TemporaryFolder()
            folder = temporary.path
            _temporary[folder] = temporary
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
    """Make a folder available for reuse, or remove it.

    Call this function after the instance is freed.
    """
    version = _of.pop(folder, None)
    if version is not None and _place is not None:
        _free.setdefault(version, []).append(folder)
    else:
        remove(folder)


def remove(folder: Path) -> None:
    """Delete a folder that must not be used again."""
    _of.pop(folder, None)
    temporary = _temporary.pop(folder, None)
    if temporary is not None:
        temporary.remove()
    else:
        shutil.rmtree(folder, ignore_errors=True)
