"""Scheduler of claimants of one directory: it executes their file operations in a given order.

Each claimant is a thread with the identity of a process of its own. It waits before each file
operation until the scheduler lets it continue, or kills it. A killed claimant has no further
effect: each of its later file operations fails with `Killed`.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from freeflyer.foundation import process_identity
from freeflyer.foundation.errors import CosimError, OutputError
from freeflyer.scenario.run_directory import RunDirectory
from freeflyer.scenario.run_state import DEAD, RECORD, ROWS, SUMMARY, UNFINISHED

AUDIT = "energy_audit.json"
EVENTS = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.listdir", "os.scandir", "os.symlink"}  # fmt: skip
_registered: dict[int, Claimant] = {}


class Killed(BaseException):
    """The claimant is dead."""


def _before_operation(event: str, arguments: tuple[Any, ...]) -> None:
    claimant = _registered.get(threading.get_ident()) if event in EVENTS else None
    if claimant is not None and not str(arguments[0]).endswith((".py", ".pyc", ".so")):
        claimant.pause()


_hooked: list[bool] = []


@dataclass
class Claimant:
    """A process that runs `job`. `number` identifies its results."""

    number: int
    job: Callable[[Claimant], None]
    world: World
    alive: bool = True
    over: bool = False
    owned: RunDirectory | None = None
    refused: str | None = None
    fault: BaseException | None = None
    steps: int = 0
    _turn: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    _waits: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))

    def start(self) -> None:
        threading.Thread(target=self._run, daemon=True).start()
        self._waits.acquire()

    def _run(self) -> None:
        _registered[threading.get_ident()] = self
        try:
            self.pause()
            self.job(self)
        except Killed:
            pass
        except OutputError as error:
            self.refused = str(error)
        except CosimError:
            pass
        except BaseException as error:
            self.fault = error
        finally:
            del _registered[threading.get_ident()]
            self.over, self.alive, self.owned = True, False, None
            self._waits.release()

    def pause(self) -> None:
        """Wait for the next turn. Called by the thread of the claimant."""
        if not self.alive:
            raise Killed
        self._waits.release()
        self._turn.acquire()
        if not self.alive:
            raise Killed

    def step(self) -> None:
        """Execute one file operation."""
        self.steps += 1
        self._turn.release()
        self._waits.acquire()

    def kill(self) -> None:
        self.alive, self.owned = False, None
        self._turn.release()
        self._waits.acquire()

    @contextlib.contextmanager
    def owner(self) -> Iterator[None]:
        """The claimant owns its directory in this block, and releases it afterwards."""
        try:
            yield
        finally:
            self.owned = None

    @property
    def identity(self) -> dict[str, Any]:
        return {"host": "here", "pid": self.number}


class World:
    """A parent folder, the claimants of its directory DIR, and what they have reported."""

    def __init__(self, parent: Path, jobs: Sequence[Callable[[Claimant], None]]) -> None:
        self.parent, self.path = parent, parent / "DIR"
        self.finished: set[int] = set()
        self.begun: set[int] = set()
        self.replaced: set[int] = set()
        """Runs that `overwrite` may have removed, or that `recover` has completed."""
        self.claimants = [Claimant(place + 1, job, self) for place, job in enumerate(jobs)]
        if not _hooked:
            sys.addaudithook(_before_operation)  # cannot be removed, and acts only on claimants
            _hooked.append(True)

    def run(self, schedule: Callable[[Sequence[Claimant]], tuple[Claimant, bool]]) -> None:
        """Run to the end. `schedule` returns the next claimant, and whether it is killed."""
        for claimant in self.claimants:
            claimant.start()
        while waiting := [one for one in self.claimants if not one.over]:
            one, killed = schedule(waiting)
            one.kill() if killed else one.step()
            owners = [c for c in self.claimants if c.owned is not None]
            assert len({c.owned.path for c in owners if c.owned}) == len(owners), "two owners"
        for claimant in self.claimants:
            if claimant.fault is not None:
                raise claimant.fault

    def check(self) -> None:
        """Check that no run is lost, changed or mixed, and that the directory is not blocked."""
        found: dict[int, Path] = {}
        rows: set[int] = set()
        for folder in self.parent.iterdir():
            numbers = {
                name: json.loads((folder / name).read_text())["run"]
                for name in (SUMMARY, RECORD, AUDIT)
                if (folder / name).exists()
            }
            if SUMMARY in numbers:
                assert len(set(numbers.values())) == 1, f"mixed: {folder.name} {numbers}"
                found[numbers[SUMMARY]] = folder
            for name in (UNFINISHED, DEAD):
                with contextlib.suppress(FileNotFoundError):
                    rows.add(json.loads((folder / name / ROWS).read_text())["run"])
        lost = self.finished - set(found) - self.replaced
        assert not lost, f"lost: {lost}"
        lost = self.begun - set(found) - rows - self.replaced
        assert not lost, f"rows lost: {lost}"
        last = RunDirectory.claim(self.path, "keep")
        with last:
            last.begin()
            last.finish({RECORD: writer(99)}, {"run": 99})
        assert json.loads((self.path / SUMMARY).read_text())["run"] == 99
        assert not (self.path / UNFINISHED).exists()


def writer(number: int) -> Callable[[Path], object]:
    return lambda path: path.write_text(json.dumps({"run": number}))


def contents(path: Path) -> set[int]:
    """Return the runs in a directory: their summaries and rows."""
    found = set()
    for name in (SUMMARY, f"{UNFINISHED}/{ROWS}", f"{DEAD}/{ROWS}"):
        with contextlib.suppress(OSError):
            found.add(json.loads((path / name).read_text())["run"])
    return found


def job_of(existing: Any, *, fails: bool = False) -> Callable[[Claimant], None]:
    """Return a run with an option of `RunDirectory.claim`. With `fails`, it does not begin."""

    def job(me: Claimant) -> None:
        claimed = RunDirectory.claim(me.world.path, existing)
        me.owned = claimed
        with claimed, me.owner():
            if fails:
                raise CosimError("bad input")
            if existing == "overwrite":
                with quiet():
                    me.world.replaced |= contents(claimed.path)
            # If another claimant is faster while the earlier content is renamed, `begin` fails.
            me.owned = None
            claimed.begin()
            me.owned = claimed
            claimed.rows.write_text(json.dumps({"run": me.number}))
            me.world.begun.add(me.number)
            claimed.describe({"run": me.number})
        _finish(me, claimed, me.number)

    return job


def recovery(me: Claimant) -> None:
    """Complete an incomplete run from its rows."""
    claimed = RunDirectory.take_over(me.world.path)
    me.owned = claimed
    with claimed, me.owner():
        try:
            number = json.loads((claimed.path / DEAD / ROWS).read_text())["run"]
        except OSError as error:
            raise CosimError("there are no rows") from error
    _finish(me, claimed, number)


def job_with_link(me: Claimant) -> None:
    """Run without a given directory."""
    claimed = RunDirectory.unique("RUN", str(me.number), me.world.parent)
    with claimed:
        claimed.begin()
    _finish(me, claimed, me.number)


def _finish(me: Claimant, claimed: RunDirectory, number: int) -> None:
    claimed.finish({RECORD: writer(number)}, {"run": number})
    me.world.finished.add(number)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Execute file operations of a claimant without a pause."""
    own = _registered.pop(threading.get_ident())
    try:
        yield
    finally:
        _registered[threading.get_ident()] = own


def identities(monkeypatch: Any, worlds: list[World]) -> None:
    """Give each claimant of the last world the identity of a process."""

    def present() -> dict[str, Any]:
        own = _registered.get(threading.get_ident())
        return {"host": "here", "pid": 1000} if own is None else own.identity

    def is_running(identity: dict[str, Any]) -> bool:
        return any(c.alive and c.number == identity.get("pid") for c in worlds[-1].claimants)

    monkeypatch.setattr(process_identity, "present", present)
    monkeypatch.setattr(process_identity, "is_running", is_running)


START = ("missing", "finished", "incomplete", "dead twice", "finished and dead")


def prepare(parent: Path, kind: str) -> set[int]:
    """Create DIR with the content of earlier runs. Return their numbers."""
    shutil.rmtree(parent, ignore_errors=True)
    path = parent / "DIR"
    if kind == "missing":
        parent.mkdir()
        return set()
    folders = {"incomplete": [UNFINISHED], "dead twice": [UNFINISHED, DEAD], "finished and dead": [UNFINISHED]}  # fmt: skip
    path.mkdir(parents=True)
    for name in folders.get(kind, []):
        (path / name).mkdir()
        (path / name / "process.json").write_text(json.dumps({"host": "here", "pid": 500}))
    if "finished" in kind:
        for name in (SUMMARY, RECORD, AUDIT):
            (path / name).write_text(json.dumps({"run": 50}))
    else:
        (path / folders[kind][-1] / ROWS).write_text(json.dumps({"run": 50}))
    return {50}
