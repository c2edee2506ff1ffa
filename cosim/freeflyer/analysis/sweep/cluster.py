"""Dask for a sweep: workers on this machine, or somebody's scheduler by its address."""

from __future__ import annotations

import logging
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from pathlib import Path

import dask
from distributed import Client, LocalCluster

from freeflyer.foundation.errors import ScenarioError
from freeflyer.scenario.metrics import versions

START = 60.0
"""How long workers of this machine may take to start [s]; they import the package."""
ANSWER = 10.0
"""How long a scheduler may take to answer, and to have a worker [s]."""
PACKAGE = "freeflyer-cosim"
SAFE_PATH = "PYTHONSAFEPATH"
"""As `-P` for the processes that Dask and multiprocessing start, also later: none runs a folder of the working directory as a module."""
CONFIGURATION = {
    # A worker that dies takes its task with it; somebody else repeats it twice before the task is blamed.
    "distributed.scheduler.allowed-failures": 2,
    # No task waits on a worker beside the one at work, so that a death is never blamed on it.
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.scheduler.work-stealing": False,
    "distributed.comm.timeouts.connect": f"{ANSWER:g}s",
    "distributed.client.scheduler-info-interval": "10s",
}


@contextmanager
def connected(scheduler: str | None, workers: int | None) -> Iterator[Client]:
    """A client with at least one worker of this package's version. Raises ScenarioError in one sentence."""
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
    """One process a worker and one thread a process, reached on the loopback only. Dask gives them one BLAS thread each."""
    folder = Path(tempfile.mkdtemp(prefix="freeflyer-sweep-"))
    cluster = client = None
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        try:
            with _deaf_to_ctrl_c():
                cluster = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address=None,
                    scheduler_kwargs={
                        "dashboard_address": "127.0.0.1:0"
                    },  # the scheduler's own pages, on any free port
                    local_directory=str(folder),
                    silence_logs=logging.CRITICAL,
                    death_timeout=START,
                )
            client = Client(cluster, timeout=START)
            client.wait_for_workers(workers, timeout=START)
        except (OSError, RuntimeError, TimeoutError) as error:
            raise ScenarioError(
                f"{workers} workers could not be started on this machine: {_said(error)}"
            ) from error
        yield client
    finally:
        for opened in (client, cluster):
            if opened is not None:
                with suppress(Exception):
                    opened.close(timeout=10)
        os.environ.pop(SAFE_PATH, None)
        if before is not None:
            os.environ[SAFE_PATH] = before
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """Threads and processes begun meanwhile, and theirs, never see a SIGINT: a terminal sends it to workers as well, and it is
    the command that decides what it means. One that comes meanwhile waits for the end of this.
    """
    resource_tracker.ensure_running()  # begun later, it would open the ears of its thread again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _remote(address: str) -> Iterator[Client]:
    try:
        client = _client_of(address)
    except (
        Exception
    ) as error:  # a name without an address, nobody there, or somebody who is no scheduler
        raise ScenarioError(
            f"the scheduler {address} does not answer within {ANSWER:g} s ({_said(error)}); start one with `dask scheduler`"
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
    """Once more after an AssertionError: distributed expects its greeting alone, and a worker that joins meanwhile is told with it."""
    try:
        return Client(address, timeout=ANSWER)
    except AssertionError:
        return Client(address, timeout=ANSWER)


def _check_versions(client: Client) -> None:
    """Before anything is sent: what another Python pickles, this one may not read."""
    here = {"python": python_version(), PACKAGE: versions()[PACKAGE]}
    for address, found in client.get_versions(packages=[PACKAGE])["workers"].items():
        there = dict(found["packages"])
        there["python"] = ".".join(str(there.get("python")).split(".")[:2])
        for name, wanted in here.items():
            if there.get(name) != wanted:
                has = f"{name} {there[name]}" if there.get(name) else f"no {name}"
                raise ScenarioError(
                    f"worker {address} has {has}, and {name} {wanted} is expected: install the same version there"
                )


def python_version() -> str:
    return f"{sys.version_info.major}.{sys.version_info.minor}"


def _said(error: Exception) -> str:
    return " ".join(str(error).split())[:200].rstrip(".") or type(error).__name__
