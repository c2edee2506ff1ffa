"""Atomic writing of result files. A file is written completely or not at all."""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from freeflyer.foundation.errors import OutputError, UnusableOutput


def write_whole(path: Path, write: Callable[[Path], object], *, durable: bool = False) -> None:
    """Write a file completely or not at all.

    `write` is called with the path of a temporary file, and must write this file. The temporary
    file is then renamed to `path`. No other process or thread has a temporary file of this name.
    With `durable`, the file is complete or absent also after a loss of power. Raises OutputError if
    the file cannot be written.
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}.partial")
    made: list[Path] = []
    try:
        made += [folder for folder in path.parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        write(partial)
        if durable:
            _flush(partial)
        os.replace(partial, path)
        if durable:
            _flush(path.parent)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error
    finally:
        # If `write` was interrupted, the temporary file still exists. It is removed here.
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
            if not path.exists():  # no empty folders for a file that was not written
                for folder in made:
                    folder.rmdir()


def _flush(path: Path) -> None:
    """Wait until a file, or the names in a directory, are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, completely or not at all.

    Raises OutputError if the file cannot be written.
    """
    write_whole(path, lambda partial: Path(partial).write_text(text, encoding="utf-8"))


@contextmanager
def staged(directory: Path) -> Iterator[Path]:
    """Yield a new folder in a directory. At the end, its files replace those of the directory.

    If the directory was renamed meanwhile, no file is written to a new directory of its name. The
    `with` block and the end raise OSError if a file cannot be written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    stage = Path(tempfile.mkdtemp(prefix=".new-", dir=directory))
    try:
        yield stage
        for path in sorted(stage.iterdir()):
            os.replace(path, directory / path.name)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def check_writable(directory: Path) -> None:
    """Check before a run that results can be written to a directory. Nothing is left behind.

    If the directory does not exist, the nearest directory above it is checked.
    Raises OutputError with exit code 2 if no file can be written to the directory.
    """
    try:
        place = directory
        while not _exists(place):
            place = place.parent
        with tempfile.TemporaryFile(dir=place, buffering=0) as file:
            file.write(bytes(4096))  # a full disk accepts an empty file
    except OSError as error:
        raise UnusableOutput(
            f"output directory {directory} cannot be written: {error.strerror or error}"
        ) from error


def _exists(path: Path) -> bool:
    """Return whether there is such a name. Raises OSError if there cannot be such a name."""
    try:
        path.lstat()
    except FileNotFoundError:
        return False
    return True


def folder(text: str) -> Path:
    """Convert the argument of `--out` to a path. Raises ArgumentTypeError if the name is empty."""
    if not text:
        raise argparse.ArgumentTypeError("a directory is expected, got an empty name")
    return Path(text)
