"""State of the directory of a run: which files it has, and which process uses it."""

from __future__ import annotations

import contextlib
import glob
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from freeflyer.foundation import process_identity

OUT = Path("freeflyer_out")
"""Folder of the runs for which no directory is given."""
SUMMARY, RECORD, STOP, UNFINISHED = "summary.json", "record.parquet", "stop.json", "unfinished"
ROWS, PROCESS, DESCRIPTION = "record.rows", "process.json", "run.json"
"""Files in the folder `unfinished`."""
DEAD, TAKEN = f"{UNFINISHED}.dead", "taken"
"""Folder `unfinished` of a dead process, and the mark in it of the process that renames it."""
UNIQUE = re.compile(r"(.+)-\d{8}-\d{6}-[0-9a-f]{8}(-\d+)?", re.DOTALL)
"""Name of a directory that `RunDirectory.unique` creates; its first group is that of the link."""
FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW
LARGEST_IDENTITY = 1 << 16
ATTEMPTS = 100
"""Largest number of attempts to claim a directory while others claim and release it."""

State = Literal["missing", "empty", "finished", "running", "incomplete", "other"]


def state(directory: Path) -> State:
    """Return the state of a directory. Raises OSError if the directory cannot be read.

    "finished": it has a summary.json, or the stop.json of devices that have not started.
    "running", "incomplete": a run that has not finished; its process runs, or has ended. "other":
    any other content.
    """
    try:
        names = set(listed(directory))
    except FileNotFoundError:
        return "missing"
    if SUMMARY in names:
        return "finished"
    if UNFINISHED in names:
        return "running" if owner(directory) else "incomplete"
    if DEAD in names:
        return "incomplete"
    return "finished" if STOP in names else "other" if names else "empty"


def listed(directory: Path) -> list[str]:
    """Return the names in a directory, without the folders of processes that claim it now."""
    return [name for name in os.listdir(directory) if not name.startswith(private(""))]


def private(token: str) -> str:
    return f".{UNFINISHED}-{token}"


def is_run(directory: Path) -> bool:
    """Return whether a directory is one of a run: finished, running or incomplete."""
    try:
        return state(directory) in ("finished", "running", "incomplete")
    except OSError:
        return False


def owner(directory: Path) -> str | None:
    """Return a text about the process that has claimed a directory, or None if there is none."""
    with contextlib.suppress(OSError), claim_of(directory) as (_, user, _):
        return user
    return None


@contextlib.contextmanager
def claim_of(directory: Path) -> Iterator[tuple[list[int], str | None, Path]]:
    """Open the folder `unfinished`, and the marks in it of processes that take it.

    Yields the handles of these nested folders, the process that lives, and the path of the last
    folder. Raises OSError if there is no folder `unfinished`.
    """
    path, handles = directory / UNFINISHED, [os.open(directory / UNFINISHED, FOLDER)]
    try:
        while (user := _user(handles[-1], path)) is None and len(handles) < ATTEMPTS:
            try:
                handles.append(os.open(TAKEN, FOLDER, dir_fd=handles[-1]))
            except OSError:
                break
            path /= TAKEN
        yield handles, user, path
    finally:
        for handle in handles:
            os.close(handle)


def _user(handle: int, claim: Path) -> str | None:
    """Return a text about the live process of an open claim, or None."""
    try:
        identity = identity_of(handle)
        running = process_identity.is_running(identity)
    except PermissionError:
        return "a process of another user"
    except (OSError, ValueError, AttributeError, RecursionError):
        return None
    if running is None:
        host = str(identity.get("host", "")).partition(" ")[0]
        return f"process {identity.get('pid')} on {host or 'another machine'}, or that process has ended: remove {claim} in this case"
    return f"process {identity['pid']}" if running else None


def identity_of(handle: int) -> Any:
    # Without O_NONBLOCK, a FIFO without a writer would block.
    file = os.open(PROCESS, os.O_RDONLY | os.O_NONBLOCK, dir_fd=handle)
    try:
        return json.loads(os.read(file, LARGEST_IDENTITY))
    finally:
        os.close(file)


def newer_incomplete(link: Path) -> list[Path]:
    """Return the incomplete runs that began after the run to which `link` links, the newest first.

    If there is no `link` yet, these are all incomplete runs of its name. If `link` is a directory
    or a file, the list is empty.
    """
    if os.path.lexists(link) and not link.is_symlink():
        return []
    newest = link.resolve().name
    beside = sorted(link.parent.glob(f"{glob.escape(link.name)}-*"), reverse=True)
    return [path for path in beside if path.name > newest and state(path) == "incomplete"]


def has_rows(directory: Path) -> bool:
    """Return whether an incomplete run has the file of the rows of its record."""
    # A process that died while it completed the run leaves the rows in the folder DEAD.
    return any((directory / name / ROWS).exists() for name in (UNFINISHED, DEAD))
