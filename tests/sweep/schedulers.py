"""External Dask schedulers and workers: separate processes, on loopback only."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

LOOPBACK = ("--host", "tcp://127.0.0.1")
PATIENCE = 90.0


@contextmanager
def scheduler(directory: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Start a scheduler; yield its address and its process."""
    ready = directory / "scheduler.json"
    options = [
        "--port",
        "0",
        "--no-dashboard",
        "--dashboard-address",
        "127.0.0.1:0",
        "--scheduler-file",
        str(ready),
    ]
    with started(["-m", "distributed.cli.dask_scheduler", *LOOPBACK, *options]) as process:
        end = time.monotonic() + PATIENCE
        while not ready.exists() or not ready.read_text().strip():
            assert process.poll() is None
            assert time.monotonic() < end
            time.sleep(0.05)
        yield json.loads(ready.read_text())["address"], process


@contextmanager
def worker(
    address: str, directory: Path, *, before: str = "", path: Path | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Start a worker in one process.

    `before` is Python code that runs first; `path` precedes all other entries of PYTHONPATH.
    """
    code = f"{before}\nimport sys\nfrom distributed.cli.dask_worker import main\nsys.argv[0] = 'dask worker'\nmain()\n"
    options = [
        "--no-nanny",
        "--nthreads",
        "1",
        "--no-dashboard",
        "--local-directory",
        str(directory),
    ]
    environment = (
        {"PYTHONPATH": os.pathsep.join([str(path), os.environ.get("PYTHONPATH", "")])}
        if path
        else {}
    )
    with started(["-c", code, address, *LOOPBACK, *options], environment) as process:
        yield process


@contextmanager
def started(
    arguments: Sequence[str], environment: dict[str, str] | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, *arguments],
        env=os.environ | (environment or {}),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()
