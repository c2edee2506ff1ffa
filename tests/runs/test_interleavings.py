"""Claimants of one directory in all orders of their file operations, and with a death anywhere."""

from __future__ import annotations

import itertools
import json
import random
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from families import family
from interleaving import (
    START,
    Claimant,
    World,
    identities,
    job_of,
    job_with_link,
    prepare,
    recovery,
)

from freeflyer.scenario.run_state import SUMMARY

JOBS: dict[str, Callable[[Claimant], None]] = {
    "none": job_of(None),
    "keep": job_of("keep"),
    "overwrite": job_of("overwrite"),
    "fails": job_of("keep", fails=True),
    "recover": recovery,
}
Explore = Callable[[str, Sequence[str], Callable[[Sequence[Claimant]], tuple[Claimant, bool]]], World]  # fmt: skip


@pytest.fixture
def explore(monkeypatch: pytest.MonkeyPatch) -> Iterator[Explore]:
    """Return a function that runs claimants from a start state in one order, and checks."""
    worlds: list[World] = []
    identities(monkeypatch, worlds)
    # Many small directories: in memory, if possible.
    memory = Path("/dev/shm")
    parent = Path(tempfile.mkdtemp(dir=memory if memory.is_dir() else None))

    def explored(
        start: str,
        jobs: Sequence[str],
        schedule: Callable[[Sequence[Claimant]], tuple[Claimant, bool]],
    ) -> World:
        folder = parent / "runs"
        before = prepare(folder, start)
        world = World(folder, [JOBS[name] for name in jobs])
        worlds.append(world)
        (world.finished if "finished" in start else world.begun).update(before)
        world.run(schedule)
        world.check()
        return world

    yield explored
    shutil.rmtree(parent)


def switched(
    at: int, dies: int | None = None
) -> Callable[[Sequence[Claimant]], tuple[Claimant, bool]]:
    """Return the order: `at` operations of the first claimant, all of the second, then the first.

    The first dies before its operation `dies`.
    """
    done = {1: 0, 2: 0}

    def schedule(waiting: Sequence[Claimant]) -> tuple[Claimant, bool]:
        first = waiting[0].number == 1 and (done[1] < at or len(waiting) == 1)
        one = waiting[0] if first else waiting[-1]
        dead = one.number == 1 and dies is not None and done[1] == dies
        done[one.number] += 1
        return one, dead

    return schedule


def at_random(seed: int, deaths: float) -> Callable[[Sequence[Claimant]], tuple[Claimant, bool]]:
    draw = random.Random(seed)
    present: list[Claimant] = []

    def schedule(waiting: Sequence[Claimant]) -> tuple[Claimant, bool]:
        # Long and short sequences of operations of one claimant.
        if not present or present[0] not in waiting or draw.random() < 0.2:
            present[:] = [draw.choice(waiting)]
        return present[0], draw.random() < deaths

    return schedule


def sampled(start: str, explore: Explore, seeds: Sequence[int]) -> None:
    """Run two or three claimants in an order that each seed gives, with and without deaths."""
    for seed in seeds:
        draw = random.Random(f"{start} {seed}")
        jobs = [draw.choice(list(JOBS)) for _ in range(draw.choice([2, 2, 3]))]
        at = draw.randrange(45)
        kind = draw.randrange(3) if len(jobs) == 2 else 2
        explore(start, jobs, [switched(at), switched(at, dies=at), at_random(seed, draw.choice([0.0, 0.02]))][kind])  # fmt: skip


@pytest.mark.parametrize("start", START)
def test_one_owner_at_a_time_and_no_run_is_lost(start: str, explore: Explore) -> None:
    sampled(start, explore, range(50))


@pytest.mark.slow
@pytest.mark.parametrize("start", START)
def test_one_owner_at_a_time_in_many_orders(start: str, explore: Explore) -> None:
    sampled(start, explore, range(1000, 1350))


@pytest.mark.slow
@pytest.mark.parametrize("start", START)
def test_one_owner_at_a_time_with_a_change_or_death_at_every_seventh_operation(
    start: str, explore: Explore
) -> None:
    for number, (one, two) in enumerate(itertools.product(JOBS, JOBS)):
        for at in itertools.count(number % 7, 7):
            dies = at if at % 2 else None
            if explore(start, (one, two), switched(at, dies=dies)).claimants[0].steps < at:
                break


@pytest.mark.parametrize("seeds", family([range(12), range(1000, 1200)]))
def test_the_link_leads_to_a_finished_run_while_others_replace_an_old_directory(
    seeds: range, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    worlds: list[World] = []
    identities(monkeypatch, worlds)
    for seed in seeds:
        parent = tmp_path / str(seed)
        (parent / "RUN").mkdir(parents=True)
        (parent / "RUN" / SUMMARY).write_text('{"run": 50}')
        world = World(parent, [job_with_link] * 3)
        worlds.append(world)
        world.run(at_random(seed, 0.02 if seed % 2 else 0.0))
        link = parent / "RUN"
        if link.is_symlink():
            assert (link / SUMMARY).exists()
            assert any(path.exists() for path in parent.glob("RUN.?/summary.json"))
        else:
            assert len(world.finished) < 3
        # Without a death, nothing is left over.
        numbers = {path.parent.name: json.loads(path.read_text())["run"] for path in parent.glob("*/summary.json")}  # fmt: skip
        assert {50, *world.finished} <= set(numbers.values())
        if seed % 2 == 0:
            assert len(list(parent.iterdir())) == 5
