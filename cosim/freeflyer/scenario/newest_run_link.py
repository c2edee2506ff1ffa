"""Link from the name of a scenario to its newest finished run."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from pathlib import Path

from freeflyer.scenario.run_state import SUMMARY


def update(link: Path, target: Path, shown: Callable[[Path], str]) -> list[str]:
    """Make `link` a relative symbolic link to the directory `target` beside it. Return notes.

    A directory of an earlier version of this package, which is not a link, is renamed. `shown`
    returns the text of a path in a note.
    """
    notes, before = [], None
    new = link.with_name(f"{link.name}.link-{os.getpid()}-{time.monotonic_ns()}")
    try:
        if link.is_symlink():
            before = link.parent / os.readlink(link)
            if before.parent != link.parent:
                return [f"{shown(link)} is a link to another folder, and stays as it is; therefore it is no link to the newest run"]  # fmt: skip
        elif os.path.lexists(link):
            if not (link / SUMMARY).is_file():
                return [f"{shown(link)} is not a run, and stays as it is; therefore it is no link to the newest run"]  # fmt: skip
            aside = free_name(link)
            try:
                os.rename(link, aside)
            except OSError:
                aside.rmdir()
                if link.is_symlink() or not link.is_dir():  # another run has renamed it
                    return update(link, target, shown)
                raise
            notes.append(f"{shown(link)} was a directory, and is now {shown(aside)}")
        os.symlink(target.name, new, target_is_directory=True)
        os.rename(new, link)
    except OSError as error:
        with contextlib.suppress(OSError):
            new.unlink()
        return [
            *notes,
            f"there is no link {shown(link)} to the newest run: {error.strerror or error}",
        ]
    notes.append(f"{shown(link)} links to this run")
    if before is not None and before != target and before.is_dir():
        notes[-1] += f"; the run before still exists: {shown(before)}"
    return notes


def free_name(path: Path) -> Path:
    """Create the empty folder PATH.1, or that with the next free number."""
    number = 1
    while True:
        free = path.with_name(f"{path.name}.{number}")
        try:
            free.mkdir()
        except FileExistsError:
            number += 1
        else:
            return free
