"""Dask client of a sweep. It uses local workers, or an existing scheduler at a given address."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker

import dask
from distributed import Client, LocalCluster

from freeflyer.foundation.errors import ScenarioError, one_line
from freeflyer.foundation.interrupts import interrupts
from freeflyer.foundation.temporary_folder import TemporaryFolder
from freeflyer.scenario.metrics import versions

START = 60.0
"""Timeout [s] for the start of the local workers. The start includes the import of the package."""
ANSWER = 10.0
"""Timeout [s] for the connection to a scheduler, and for the wait until it has a worker."""
PACKAGE = "freeflyer-cosim"
SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable with the effect of Python's option `-P`. Child processes inherit it.

Therefore child processes do not import modules from the working directory.
"""
CONFIGURATION = {
    # If the worker of a task dies, the task is repeated on another worker. The task is repeated at
    # most twice. If the third worker also dies, the task has failed.
    "distributed.scheduler.allowed-failures": 2,
    # Do not queue tasks on a busy worker. If this worker died, the failure would also be counted
    # for the queued tasks.
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.scheduler.work-stealing": False,
    "distributed.comm.timeouts.connect": f"{ANSWER:g}s",
    "distributed.client.scheduler-info-interval": "10s",
}


@contextmanager
def connected(scheduler: str | None, workers: int | None) -> Iterator[Client]:
    """Connect to the address `scheduler`, or start local workers (default: one per core).

    Yields a client with at least one worker. Raises ScenarioError if no worker can be used.
    """
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with dask.config.set(CONFIGURATION):
        if scheduler is None:
            with _local(workers or os.cpu_count() or 1) as client:
                yield client
        else:
            with _remote(scheduler) as client:
                yield client


@contextmanager
def _local(workers: int) -> Iterator[Client]:
    """Start worker processes that listen only on loopback.

    Each process has one thread. Dask also limits BLAS to one thread.
    """
    folder = TemporaryFolder()
    cluster = client = None
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    # A worker process would import the main module, and so run the script of the user again.
    script = sys.modules["__main__"]
    attributes = {name: vars(script).pop(name, None) for name in ("__file__", "__spec__")}
    script.__spec__ = None
    try:
        try:
            with interrupts() as interrupted:  # Dask cannot close a cluster that starts
                with _blocked_signals():
                    cluster = LocalCluster(
                        n_workers=workers,
                        threads_per_worker=1,
                        processes=True,
                        host="127.0.0.1",
                        dashboard_address=None,
                        # The scheduler's HTTP server uses any free port.
                        scheduler_kwargs={
                            "dashboard_address": "127.0.0.1:0",
                            "local_directory": str(folder.path),
                        },
                        local_directory=str(folder.path),
                        silence_logs=logging.CRITICAL,
                        death_timeout=START,
                    )
                client = Client(cluster, timeout=START)
                client.wait_for_workers(workers, timeout=START)
            if interrupted:
                raise KeyboardInterrupt
        except (OSError, RuntimeError, TimeoutError) as error:
            raise ScenarioError(
                f"{workers} workers could not be started on this machine: {one_line(error, 200).rstrip('.')}"
            ) from error
        yield client
    finally:
        for opened in (client, cluster):
            if opened is not None:
                with interrupts(), suppress(Exception):
                    opened.close(timeout=10)
        os.environ.pop(SAFE_PATH, None)
        if before is not None:
            os.environ[SAFE_PATH] = before
        vars(script).update({n: value for n, value in attributes.items() if value is not None})
        folder.remove()


@contextmanager
def _blocked_signals() -> Iterator[None]:
    """Block SIGINT and SIGHUP for the threads and processes that are started inside this context.

    After Ctrl-C, a terminal sends SIGINT to the command and also to the workers. When it is closed,
    it sends SIGHUP. The workers must not react. They inherit the blocked signals. If the command
    receives such a signal inside the context, it is delivered at the end of the context.
    """
    # The start of the resource tracker unblocks SIGINT in the calling thread. Therefore the tracker
    # is started before the signals are blocked.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _remote(address: str) -> Iterator[Client]:
    try:
        client = _client_of(address)
    # The cause can be an unknown host name, a closed port, or a peer that is not a Dask scheduler.
    except Exception as error:
        raise ScenarioError(
            f"the scheduler {address} does not answer within {ANSWER:g} s ({one_line(error, 200).rstrip('.')}); start one with `dask scheduler`"
        ) from error
    try:
        try:
            client.wait_for_workers(1, timeout=ANSWER)
        except TimeoutError as error:
            raise ScenarioError(
                f"the scheduler {address} has no workers; start one with `dask worker {address}`"
            ) from error
        _check_versions(client)
        yield client
    finally:
        with suppress(Exception):
            client.close(timeout=10)


def _client_of(address: str) -> Client:
    """Connect to a scheduler, and retry once after an AssertionError.

    The package distributed raises this error if the first message of the scheduler also announces a
    new worker.
    """
    try:
        return Client(address, timeout=ANSWER)
    except AssertionError:
        return Client(address, timeout=ANSWER)


def _check_versions(client: Client) -> None:
    """Raise ScenarioError if a worker has another version of Python or of this package.

    With different versions, pickled objects may be incompatible.
    """
    here = {"python": python_version(), PACKAGE: versions()[PACKAGE]}
    for address, found in client.get_versions(packages=[PACKAGE])["workers"].items():
        there = dict(found["packages"])
        there["python"] = ".".join(str(there.get("python")).split(".")[:2])
        for name, wanted in here.items():
            if there.get(name) != wanted:
                has = f"{name} {there[name]}" if there.get(name) else f"no {name}"
                raise ScenarioError(
                    f"worker {address} has {has}, but {name} {wanted} is expected; install the same version on the worker"
                )


def python_version() -> str:
    return f"{sys.version_info.major}.{sys.version_info.minor}"
