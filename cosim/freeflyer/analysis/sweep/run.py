"""Compute the unfinished runs of a plan in small batches on Dask.

The results of each batch are written as soon as they arrive.
"""

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
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.exit_codes import STOPPED
from freeflyer.foundation.interrupts import interrupts
from freeflyer.foundation.plugins import described
from freeflyer.scenario.metrics import versions

BATCH = 1.0
"""Target duration of a batch [s].

A batch is one Dask task. The duration is much longer than the overhead of a task. It is not longer
than necessary, because an interrupt discards unfinished batches.
"""
LARGEST_BATCH = 200
AHEAD = 3
"""Number of submitted batches per thread.

The number is large enough to keep all threads busy. It is small enough to limit the memory.
"""
POLL_INTERVAL = 0.02
"""Time between two polls for finished batches [s]."""
THREAD_COUNT_INTERVAL = 5.0
"""Time [s] between two counts of the threads. The count changes when workers join or leave."""

Progress = Callable[[int], None]
"""Function that is called with the number of finished runs."""


@dataclass(frozen=True, kw_only=True)
class Ended:
    """Outcome of `run`. `computed` is the number of runs that this call computed."""

    interrupted: bool
    computed: int


def run(plan: Plan, results: Results, client: Client, progress: Progress) -> Ended:
    """Compute the runs that `results` does not contain. Ctrl-C stops the sweep between two batches.

    Raises ScenarioError if the scheduler or a worker fails. Raises OutputError if a file cannot be
    written.
    """
    return _Work(plan, results, client, progress).run()


class _Work:
    def __init__(self, plan: Plan, results: Results, client: Client, progress: Progress) -> None:
        self.plan, self.results, self.client, self.progress = plan, results, client, progress
        self.pending = deque(number for number in range(len(plan)) if number not in results.runs)
        self.total = len(self.pending)
        self.computed = self.sent = 0
        self.suspects: deque[int] = deque()
        """Runs whose worker died.

        Each of these runs is repeated alone, to find the run that kills the workers.
        """
        self.seconds: float | None = None
        """Smoothed duration of a run [s]. As long as it is None, a batch is a single run."""
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
                    time.sleep(POLL_INTERVAL)
                for future in self.batches:
                    future.cancel()
            except OSError as error:  # distributed's CommClosedError is an OSError
                raise _lost() from error
        return Ended(interrupted=bool(interrupted), computed=self.computed)

    def _submit(self) -> None:
        while self.pending and len(self.batches) < AHEAD * self.threads:
            # Smaller batches towards the end keep all threads busy.
            share = math.ceil(len(self.pending) / (2 * self.threads))
            target = int(BATCH / self.seconds) if self.seconds else 1
            size = max(1, min(target, LARGEST_BATCH, share))
            self._send([self.pending.popleft() for _ in range(min(size, len(self.pending)))])
        if self.suspects and not self.batches:
            self._send([self.suspects.popleft()])

    def _send(self, numbers: list[int]) -> None:
        runs = [self.plan.run(number) for number in numbers]
        # The setup (5 kB) is sent with each batch. Therefore a worker stores nothing that would be
        # lost if the worker is replaced. All tasks have the same key prefix. Therefore the
        # scheduler assigns the tasks one by one to free threads.
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
            raise ScenarioError(f"a worker cannot compute this sweep: {error}")
        if isinstance(error, KilledWorker):
            self._handle_killed(numbers, error)
            return
        if error is not None:
            # The worker failed before the first run of the batch. For a failed run, `run_batch`
            # raises no error: it returns a row with the cause.
            self._keep(
                [
                    {
                        "run": number,
                        **failure(f"the worker failed: {described(error)}"),
                    }
                    for number in numbers
                ]
            )
            return
        rows = future.result()
        mean = sum(row["run_s"] for row in rows) / len(rows)
        self.seconds = mean if self.seconds is None else 0.7 * self.seconds + 0.3 * mean
        self._keep(rows)

    def _handle_killed(self, numbers: Sequence[int], error: KilledWorker) -> None:
        """Handle a batch whose worker died. `numbers` are the runs of the batch.

        If the batch has one run and no other run was active, this run has failed. Otherwise each
        run of the batch is repeated alone later.
        """
        alone = len(numbers) == 1 and not self.batches and not self.pending
        if not alone:
            self.suspects.extend(numbers)
            return
        cause = f"its worker died in each of {error.allowed_failures + 1} attempts, even when no other run was active"
        self._keep([{"run": numbers[0], **failure(cause)}])

    def _keep(self, rows: list[dict[str, object]]) -> None:
        self.results.add(rows)
        self.computed += len(rows)
        self.progress(len(self.results.runs))

    @property
    def threads(self) -> int:
        now = time.monotonic()
        if now - self._counted > THREAD_COUNT_INTERVAL:
            self._threads, self._counted = max(1, sum(self.client.nthreads().values())), now
        return self._threads


def _lost() -> ScenarioError:
    error = ScenarioError(
        "the scheduler does not answer any more; finished runs are kept, and the same command computes the remaining runs"
    )
    error.exit_code = STOPPED
    return error
