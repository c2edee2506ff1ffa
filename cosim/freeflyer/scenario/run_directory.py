"""Output directory of one run.

A process claims a directory by the folder `unfinished` in it. The folder contains the identity of
the process, the description of the run, and the rows of its record while the run lasts.
`summary.json` is written last, and then the folder is removed. A directory without `summary.json`
is an incomplete run.

Only `mkdir` and `rename` must be atomic. The folder appears by a rename, with the identity of its
process. A rename fails if the target is a folder that is not empty. Therefore only one process
claims a directory. The folder disappears by a rename, too: by its process, or by another one after
the death of its process (`_take`). Therefore a folder without its identity has no live process. No
file of a run is moved while the run lasts.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import shutil
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from freeflyer.foundation import process_identity
from freeflyer.foundation.errors import CosimError, OutputError, UnusableOutput
from freeflyer.foundation.output_file import write_text, write_whole
from freeflyer.scenario import newest_run_link
from freeflyer.scenario.newest_run_link import free_name
from freeflyer.scenario.run_state import (
    ATTEMPTS,
    DEAD,
    DESCRIPTION,
    OUT,
    PROCESS,
    RECORD,
    ROWS,
    STOP,
    SUMMARY,
    TAKEN,
    UNFINISHED,
    UNIQUE,
    claim_of,
    identity_of,
    listed,
    private,
    state,
)

WRITTEN = (
    SUMMARY, RECORD, STOP, "facility.json", "view.html", "energy_audit.json", "energy_audit.p[dn][fg]",
    "recording.mcap", "recording_[0-9]*.mcap", "flight_recording.mcap", "can.blf", "can.asc", "can_*.blf", "can_*.asc",
)  # fmt: skip
"""Patterns of the files that runs and their audits write. `overwrite` removes no other file."""
Existing = Literal["keep", "overwrite"]
"""What happens to a directory that is not empty.

"keep" renames the directory to DIR.1, or to the next free number. "overwrite" removes the files of
the earlier run. Without either, a finished run is kept and any other content is an error.
"""


class RunDirectory:
    """A directory that this process has claimed for one run.

    Use `claim` or `unique` to create an object. Then call `begin` before the first step, and
    `finish` after the last. As a context, it undoes everything if the run does not begin. `path` is
    the directory. `notes` are sentences about what was done to other directories.
    """

    path: Path
    notes: list[str]

    @classmethod
    def unique(cls, label: str, about: str, parent: Path = OUT) -> RunDirectory:
        """Claim a new directory PARENT/LABEL-TIME-HASH. TIME is UTC; `about` is hashed.

        `finish` makes PARENT/LABEL a link to the directory. Raises OutputError.
        """
        digest = hashlib.sha256(about.encode("utf-8", "surrogatepass")).hexdigest()[:8]
        name = f"{label}-{time.strftime('%Y%m%d-%H%M%S', time.gmtime())}-{digest}"
        number = 1
        while True:
            try:
                return cls(parent / (name if number == 1 else f"{name}-{number}"), new=True, link=parent / label)  # fmt: skip
            except FileExistsError:
                number += 1

    @classmethod
    def claim(cls, directory: Path, existing: Existing | None = None) -> RunDirectory:
        """Claim a directory. Raises OutputError if it is in use, or has other content.

        `existing` is what happens to the content of the directory (`Existing`).
        """
        return cls(directory, existing=existing)

    @classmethod
    def take_over(cls, directory: Path) -> RunDirectory:
        """Claim the directory of an incomplete run, to complete it. Raises OutputError."""
        found = cls(directory, existing="overwrite")
        found._begun = found._took_over
        # A process may have died after it wrote summary.json.
        if not found._took_over or (directory / SUMMARY).exists():
            found.abandon()
            raise UnusableOutput(f"{directory} is not the directory of an incomplete run")
        name = UNIQUE.fullmatch(found.path.name)
        if name is not None:
            link = found.path.with_name(name[1])
            # The link does not return from a newer run.
            if not os.path.lexists(link) or (link.is_symlink() and os.readlink(link) < found.path.name):  # fmt: skip
                found._link = link
        return found

    def __init__(
        self,
        path: Path,
        *,
        existing: Existing | None = None,
        new: bool = False,
        link: Path | None = None,
    ) -> None:
        # A component, or another thread that loads an FMU, may change the working directory.
        self._relative_to = None if path.is_absolute() else Path.cwd()
        path = self.path = Path(os.path.abspath(path))
        self.notes = []
        self._existing, self._aside = existing, False
        self._link = None if link is None else Path(os.path.abspath(link))
        self._made: list[Path] = []
        self._took_over = self._begun = False
        self._token = uuid.uuid4().hex
        self._moved_to: Path | None = None
        try:
            if path.is_symlink():
                raise OSError(errno.EEXIST, f"it is a symbolic link to {os.readlink(path)}; give the target, or another directory")  # fmt: skip
            found = "missing" if new else state(path)
            if found in ("other", "incomplete") and existing is None:
                text = "an incomplete run (`freeflyer recover` completes it)" if found == "incomplete" else "other files than a run"  # fmt: skip
                raise OSError(errno.EEXIST, f"it contains {text}; choose another directory, or rename it by --keep, or replace its results by --overwrite")  # fmt: skip
            self._lock(exclusive=new)
            # The content may have changed before the directory was claimed.
            self._aside = existing != "overwrite" and listed(path) != [UNFINISHED]
            if self._aside and os.path.samefile(path, os.curdir):
                raise OSError(errno.EEXIST, "it is the current directory and is not empty; choose another directory, or replace its results by --overwrite")  # fmt: skip
        except FileExistsError as error:
            self.abandon()
            if new and error.strerror == os.strerror(errno.EEXIST):
                raise
            raise self._refused(error) from error
        except OSError as error:
            self.abandon()
            raise self._refused(error) from error
        except OutputError:
            self.abandon()
            raise

    def _make(self, path: Path, *, exclusive: bool) -> None:
        """Create the directory and its missing parents."""
        missing = [path]
        while not missing[-1].parent.exists() and missing[-1].parent != missing[-1]:
            missing.append(missing[-1].parent)
        for folder in reversed(missing):
            try:
                folder.mkdir()
                self._made.append(folder)
            except FileExistsError:
                if exclusive and folder == path:
                    raise
                if not folder.is_dir():
                    raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR)) from None

    def _lock(self, *, exclusive: bool) -> None:
        """Create the directory and its folder `unfinished`, which only one process can do."""
        own = self.path / private(self._token)
        try:
            for _ in range(ATTEMPTS):
                self._make(self.path, exclusive=exclusive and self.path not in self._made)
                # If another process renames or removes the directory now, try again.
                with contextlib.suppress(FileNotFoundError, NotADirectoryError):
                    own.mkdir(exist_ok=True)
                    identity = {**process_identity.present(), "claim": self._token}
                    (own / PROCESS).write_text(json.dumps(identity), encoding="utf-8")
                    if _renamed(own, self.path / UNFINISHED):
                        self._took_over = (self.path / DEAD).exists()
                        return
                    self._take(own)
            raise UnusableOutput(f"output directory {self.shown(self.path)} is in use by other processes; choose another directory")  # fmt: skip
        finally:
            shutil.rmtree(own, ignore_errors=True)

    def _take(self, own: Path) -> None:
        """Rename the folder `unfinished` of a dead process. Raises OutputError if it lives.

        The process that puts its mark into the folder may rename it. The mark stays in the folder,
        so that no other process can rename a newer folder instead.
        """
        folder = self.path / UNFINISHED
        with claim_of(self.path) as (handles, user, _):
            if user is not None:
                self._made = []
                raise UnusableOutput(f"output directory {self.shown(self.path)} is in use by {user}; wait until it ends, or choose another directory")  # fmt: skip
            if not _renamed(own, Path(TAKEN), handles[-1]):
                return
            if not os.path.samestat(os.fstat(handles[0]), os.stat(folder)):
                return
            # If an earlier process has renamed one before, and died before it began, its own
            # folder has no results.
            if (self.path / DEAD).exists():
                _remove(folder, self._token)
            else:
                os.rename(folder, self.path / DEAD)

    def _holds(self) -> bool:
        """Return whether this object still holds the directory of this path."""
        with contextlib.suppress(OSError, ValueError, AttributeError, RecursionError), claim_of(self.path) as (handles, _, _):  # fmt: skip
            return bool(identity_of(handles[0]).get("claim") == self._token)
        return False

    @property
    def rows(self) -> Path:
        """Path of the file for the rows of the record."""
        return self.path / UNFINISHED / ROWS

    def begin(self) -> None:
        """Set earlier content aside, or remove it. Raises OutputError."""
        try:
            if self._aside:
                self._set_aside()
            elif self._existing == "overwrite":
                shutil.rmtree(self.path / DEAD, ignore_errors=True)
                for pattern in WRITTEN:
                    for file in self.path.glob(pattern):
                        file.unlink()
        except OSError as error:
            raise self._refused(error) from error
        self._begun = True

    def describe(self, description: Mapping[str, Any]) -> None:
        """Store what is run, for `saved_run.complete`. Raises OutputError."""
        write_text(self.path / UNFINISHED / DESCRIPTION, json.dumps(description))

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, place: object) -> None:
        """Undo everything if the run did not begin, or failed at its first instant."""
        if error is not None and (not self._begun or isinstance(error, CosimError)):
            self.abandon()
        elif error is not None:
            self.leave()

    def _set_aside(self) -> None:
        """Rename the directory, and create it again with the folder `unfinished`."""
        what = "the run before" if state(self.path) == "finished" else "the earlier content"
        aside = free_name(self.path)
        try:
            os.rename(self.path, aside)  # replaces the empty folder
        except OSError:
            aside.rmdir()
            raise
        fresh = self.path.with_name(f"{self.path.name}.claim-{self._token}")
        fresh.mkdir()
        os.rename(aside / UNFINISHED, fresh / UNFINISHED)
        try:
            os.rename(fresh, self.path)
        except OSError as error:
            shutil.rmtree(fresh)
            raise OSError(error.errno, f"another process has claimed it; {what} is now {self.shown(aside)}") from error  # fmt: skip
        finally:
            _restore(aside)
            _sweep(aside)
        self.notes.append(f"{what} still exists: {self.shown(aside)}")
        self._moved_to, self._made = aside, [self.path]

    def finish(
        self, files: Mapping[str, Callable[[Path], object]], summary: Mapping[str, Any]
    ) -> None:
        """Write the files, and then summary.json. A file is written by a function of its path.

        Raises OutputError if a file cannot be written. The run then stays incomplete, with its
        rows.
        """
        self._replace_if_removed()
        rows = self.rows if self.rows.exists() else None
        for audit in self.path.glob("energy_audit.*"):  # written meanwhile, of an earlier record
            with contextlib.suppress(OSError):
                audit.unlink()
        try:
            for name, write in files.items():
                write_whole(self.path / name, write, durable=True)
            text = json.dumps(summary, indent=2) + "\n"
            write_whole(self.path / SUMMARY, lambda partial: partial.write_text(text, encoding="utf-8"), durable=True)  # fmt: skip
        except BaseException as error:
            if rows is None:
                raise
            self.leave()
            if not isinstance(error, OutputError):
                raise
            raise OutputError(f"{error}. The rows of the record are kept in {self.shown(self.path)}; `freeflyer recover {self.shown(self.path)}` writes the results later") from error  # fmt: skip
        self.release()
        if self._link is not None:
            self.notes += newest_run_link.update(self._link, self.path, self.shown)

    def release(self) -> None:
        """Remove the folder `unfinished`: the run is complete, or nothing more can be completed."""
        shutil.rmtree(self.path / DEAD, ignore_errors=True)
        _sweep(self.path)
        for name in (RECORD, SUMMARY):  # a process that was killed may have left parts of a file
            for partial in self.path.glob(f"{name}.*.partial"):
                with contextlib.suppress(OSError):
                    partial.unlink()
        _remove(self.path / UNFINISHED, self._token)

    def leave(self) -> None:
        """Leave an incomplete run, which also this process can complete now."""
        with contextlib.suppress(OSError):
            if self._holds():
                os.rename(self.path / UNFINISHED, self.path / DEAD)
                (self.path / DEAD / PROCESS).unlink()  # this process lives

    def _replace_if_removed(self) -> None:
        """If the directory was removed or replaced during the run, claim another one."""
        if self._holds():
            return
        lost = self.path
        other = RunDirectory.claim(free_name(lost), None)
        self.path, self._token = other.path, other._token
        self.notes.append(f"{self.shown(lost)} was removed or renamed during the run; the results are in {self.shown(self.path)} instead")  # fmt: skip

    def abandon(self) -> None:
        """Remove the directory, and restore what was there before. Use it before the first row."""
        held = self._holds()
        if held:
            _remove(self.path / UNFINISHED, self._token)
        for made in reversed(self._made):
            with contextlib.suppress(OSError):
                made.rmdir()
        with contextlib.suppress(OSError):
            if self._moved_to is not None and not self.path.exists():
                os.rename(self._moved_to, self.path)
            elif held and self._took_over:
                _restore(self.path)
        self._made, self._moved_to, self._took_over = [], None, False

    def shown(self, path: Path) -> str:
        """Return the text of a path in a message: relative, if the user gave a relative path."""
        return str(path if self._relative_to is None else os.path.relpath(path, self._relative_to))

    def _refused(self, error: OSError) -> OutputError:
        """Return the error with exit code 2 for a directory that cannot be used."""
        reason = error.strerror or str(error)
        above = next((one for one in (self.path, *self.path.parents) if os.path.lexists(one)), None)
        if above is not None and not above.is_dir():
            reason = f"{self.shown(above)} is not a directory"
        return UnusableOutput(f"output directory {self.shown(self.path)} cannot be used: {reason}")

    @property
    def lines(self) -> Iterator[str]:
        """Sentences for the user: the directory of the results, and `notes`."""
        yield f"Results in {self.shown(self.path)}: {RECORD}, {SUMMARY}"
        yield from self.notes


def _renamed(folder: Path, target: Path, handle: int | None = None) -> bool:
    """Rename a folder, unless the target is a folder that is not empty. Return whether it is done.

    `target` is relative to the folder with the open handle `handle`, if given.
    """
    try:
        os.rename(folder, target, dst_dir_fd=handle)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
        return False
    return True


def _remove(folder: Path, token: str) -> None:
    """Remove a folder `unfinished`, which disappears at once."""
    hidden = folder.with_name(private(f"{token}-{time.monotonic_ns()}"))
    with contextlib.suppress(OSError):
        os.rename(folder, hidden)
        shutil.rmtree(hidden, ignore_errors=True)


def _restore(directory: Path) -> None:
    """Make the folder of a dead process `unfinished` again."""
    with contextlib.suppress(OSError):
        if _renamed(directory / DEAD, directory / UNFINISHED):
            _remove(directory / UNFINISHED / TAKEN, "")


def _sweep(directory: Path) -> None:
    """Remove the folders of processes that died while they claimed a directory."""
    for folder in directory.glob(f"{private('')}*"):
        shutil.rmtree(folder, ignore_errors=True)
