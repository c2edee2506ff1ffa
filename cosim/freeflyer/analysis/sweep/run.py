"""A sweep: all runs of a plan that are not finished yet, in small batches on Dask, each batch kept as soon as it is there."""

from __future__ import annotations

import math
import time
import uuid
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from distributed import Client, Future, as_completed
from distributed.scheduler import KilledWorker

from freeflyer.analysis.sweep.plan import Plan
from freeflyer.analysis.sweep.results import Results
from freeflyer.analysis.sweep.task import WorkerRefused, failure, run_batch
from freeflyer.foundation.errors import STOPPED, ScenarioError
from freeflyer.foundation.interrupts import interrupts
from freeflyer.scenario.metrics import versions

BATCH = 1.0
"""A batch takes about this long [s]: long beside what a task costs, short beside what an interrupt may lose."""
LARGEST_BATCH = 200
AHEAD = 3
"""Batches that are with the scheduler at a time, for each of its threads: none waits for us, and its memory stays flat."""
LOOK = 0.02
"""Time between two looks at what is finished [s]."""
LOOK_AT_THREADS = 5.0
"""Time between two counts of a scheduler's threads, which come and go [s]."""

Progress = Callable[[int], None]


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a call of `run` ended."""

    interrupted: bool
    computed: int


def run(plan: Plan, results: Results, client: Client, progress: Progress) -> Ended:
    """Compute what `results` has not yet. Ctrl-C ends it between two batches. Raises ScenarioError, OutputError."""
    return _Work(plan, results, client, progress).run()


class _Work:
    def __init__(self, plan: Plan, results: Results, client: Client, progress: Progress) -> None:
        self.plan, self.results, self.client, self.progress = plan, results, client, progress
        self.pending = deque(number for number in range(len(plan)) if number not in results.runs)
        self.total = len(self.pending)
        self.computed = self.sent = 0
        self.suspects: deque[int] = deque()
        """Runs whose worker died: each is tried once more, alone, so that none is blamed for its neighbour."""
        self.seconds: float | None = (
            None  # of a run, smoothed; unknown at first, so that the first batches are single runs
        )
        self.batches: dict[Future, list[int]] = {}
        self.finished = as_completed(loop=client.loop)
        self.version = versions()["freeflyer-cosim"]
        self.name = f"run_batch-{uuid.uuid4().hex}"
        self._threads, self._counted = 1, -math.inf

    def run(self) -> Ended:
        with interrupts() as interrupted:
            try:
                while (self.pending or self.suspects or self.batches) and not interrupted:
                    self._submit()
                    for future in self.finished.next_batch(block=False):
                        self._take(future)
                    time.sleep(LOOK)
                for future in self.batches:
                    future.cancel()
            except OSError as error:  # also what distributed raises for a connection that is gone
                raise _lost() from error
        return Ended(interrupted=bool(interrupted), computed=self.computed)

    def _submit(self) -> None:
        while self.pending and len(self.batches) < AHEAD * self.threads:
            left = math.ceil(
                len(self.pending) / (2 * self.threads)
            )  # towards the end all have something to do
            wished = int(BATCH / self.seconds) if self.seconds else 1
            size = max(1, min(wished, LARGEST_BATCH, left))
            self._send([self.pending.popleft() for _ in range(min(size, len(self.pending)))])
        if self.suspects and not self.batches:
            self._send([self.suspects.popleft()])

    def _send(self, numbers: list[int]) -> None:
        runs = [self.plan.run(number) for number in numbers]
        # The set-up goes along with each batch: it is 5 kB, and nothing on a worker that could be lost with it.
        # One name for all tasks: the scheduler then hands them out one by one, as threads become free.
        self.sent += 1
        future = self.client.submit(
            run_batch, self.plan.setup, self.version, runs, key=(self.name, self.sent)
        )
        self.batches[future] = numbers
        self.finished.add(future)

    def _take(self, future: Future) -> None:
        numbers = self.batches.pop(future)
        if future.status == "cancelled":
            raise _lost()
        error = future.exception() if future.status == "error" else None
        if isinstance(error, WorkerRefused):
            raise ScenarioError(f"a worker cannot take part: {error}")
        if isinstance(error, KilledWorker):
            self._blame(numbers, error)
            return
        if error is not None:
            # Not a run's own failure, which is a row: the worker could not even begin.
            self._keep(
                [
                    {
                        "run": number,
                        **failure(f"its worker failed: {type(error).__name__}: {error}"),
                    }
                    for number in numbers
                ]
            )
            return
        rows = future.result()
        mean = sum(row["run_s"] for row in rows) / len(rows)
        self.seconds = mean if self.seconds is None else 0.7 * self.seconds + 0.3 * mean
        self._keep(rows)

    def _blame(self, numbers: Sequence[int], error: KilledWorker) -> None:
        alone = len(numbers) == 1 and not self.batches and not self.pending
        if not alone:
            self.suspects.extend(numbers)
            return
        cause = f"its worker died each of {error.allowed_failures + 1} times that it was tried, the last time alone"
        self._keep([{"run": numbers[0], **failure(cause)}])

    def _keep(self, rows: list[dict[str, object]]) -> None:
        self.results.add(rows)
        self.computed += len(rows)
        self.progress(len(self.results.runs))

    @property
    def threads(self) -> int:
        now = time.monotonic()
        if now - self._counted > LOOK_AT_THREADS:
            self._threads, self._counted = max(1, sum(self.client.nthreads().values())), now
        return self._threads


def _lost() -> ScenarioError:
    error = ScenarioError(
        "the scheduler does not answer any more; what was finished is kept, and the same command goes on from there"
    )
    error.exit_code = STOPPED
    return error
