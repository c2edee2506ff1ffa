"""Temporary folders that do not remain after their process, not even after SIGKILL.

A folder `freeflyer-tmp-...` in the temporary directory contains a lock file and the folder of the
content. Its process locks the lock file with flock. The kernel releases this lock when the process
ends. The first temporary folder of a process removes all folders whose lock is free.
"""

from __future__ import annotations

import atexit
import fcntl
import os
import shutil
import tempfile
import weakref
from contextlib import suppress
from functools import cache
from pathlib import Path

from freeflyer.foundation.errors import CosimError

PREFIX = "freeflyer-tmp-"
"""Other than that of earlier versions, whose many old folders would have to be examined."""
LOCK = "freeflyer.lock"
CONTENT = "content"
_held: dict[Path, int] = {}
"""For each temporary folder of this process: the descriptor of its lock file."""


class TemporaryFolder:
    """An empty folder `path`. It is a context manager that returns `path`.

    The folder is removed by `remove`, with this object, or at the end of the process. After
    SIGKILL, the next process that makes a temporary folder removes it.
    Raises CosimError if the folder cannot be made.
    """

    def __init__(self) -> None:
        try:
            directory = tempfile.gettempdir()
            _remove_abandoned(directory)
            folder = _made(directory)
        except OSError as error:
            where = tempfile.tempdir and f"{tempfile.tempdir}: {error.strerror}"
            raise CosimError(
                f"a temporary folder cannot be made: {where or 'no temporary directory can be written'}; set TMPDIR to a directory that can be written"
            ) from error
        self.path = folder / CONTENT
        self.remove = weakref.finalize(self, _remove, folder)

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *_: object) -> None:
        self.remove()


def _made(directory: str) -> Path:
    """Make a folder with a locked lock file."""
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=directory))
    try:
        handle = _held[folder] = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
        # On a file system without locks, the folder remains after SIGKILL.
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        (folder / CONTENT).mkdir()
    except BaseException as error:
        _delete(folder)
        if folder in _held:
            os.close(_held.pop(folder))
        if isinstance(error, FileNotFoundError):  # another process removed it before the lock
            return _made(directory)
        raise
    return folder


def _remove(folder: Path) -> None:
    """Remove a folder of this process. A forked child does not remove the folders of its parent."""
    if folder in _held:
        _delete(folder)
        os.close(_held.pop(folder))


def _delete(folder: Path) -> None:
    # The lock file is deleted last. If the process is killed before, the next one continues.
    shutil.rmtree(folder / CONTENT, ignore_errors=True)
    shutil.rmtree(folder, ignore_errors=True)


@cache
def _remove_abandoned(directory: str) -> None:
    """Remove the folders of ended processes of this user. Each directory is searched only once.

    Folders with content but without our lock file, symbolic links and folders of other users are
    left.
    """
    with suppress(OSError):
        for entry in list(os.scandir(directory)):
            if entry.name.startswith(PREFIX):
                with suppress(OSError):
                    own = entry.stat(follow_symlinks=False).st_uid == os.getuid()
                    if own and entry.is_dir(follow_symlinks=False):
                        _remove_if_unlocked(Path(entry.path))


def _remove_if_unlocked(folder: Path) -> None:
    try:
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_NOFOLLOW)
    except FileNotFoundError:  # if it is empty, its process was killed before it made the file
        folder.rmdir()
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _delete(folder)
    finally:
        os.close(handle)


def _close_inherited() -> None:
    """Close the inherited lock files in a forked child. The lock of the parent remains."""
    for handle in _held.values():
        os.close(handle)
    _held.clear()


os.register_at_fork(after_in_child=_close_inherited)


@atexit.register
def _remove_all() -> None:
    """Remove the remaining folders, for example one whose removal was interrupted by Ctrl-C."""
    for folder in list(_held):
        _remove(folder)
