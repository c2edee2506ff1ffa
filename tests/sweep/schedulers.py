"""Dask schedulers and workers as others start them: processes of their own, on the loopback only."""

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
    """Its address, and its process."""
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
    """A worker in one process. `before` is Python that it runs first; `path` is searched before all other packages."""
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
