"""Processes of `freeflyer` that are killed, and the records that they leave."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import freeflyer as ff
from freeflyer.foundation.errors import OutputError, RecordError
from freeflyer.master import row_file
from freeflyer.master.record import Record

SCENARIO = "multirate_passive"
SHORT = {"stop_s": 0.5}
ENDLESS = ("--set", "stop_s=3000", "--set", "record.every_s=0.1")
"""A run that lasts much longer than a test."""


def freeflyer(*arguments: object, before: str = "", **options: Any) -> subprocess.Popen[str]:
    """Start a command. `before` is Python code that is executed first in its process."""
    code = f"import sys\n{before}\nfrom freeflyer.cli.main import main\nsys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def done(*arguments: object, **options: Any) -> tuple[int, str, str]:
    """Run a command; return its exit code, its output and its error without a traceback."""
    with freeflyer(*arguments, **options) as process:
        try:
            output, error = process.communicate(timeout=120)
        except BaseException:
            process.kill()
            raise
    assert "Traceback" not in error, error
    return process.returncode, output, error


def until(condition: Callable[[], object], process: subprocess.Popen[str]) -> None:
    """Wait until a condition is true. Fails if the process ends before."""
    end = time.monotonic() + 60
    while not condition():
        if process.poll() is not None:
            output, error = process.communicate()
            raise AssertionError(f"exit code {process.returncode}: {output}{error}")
        assert time.monotonic() < end
        time.sleep(0.01)


def rows_in(directory: Path) -> int:
    """Return the number of rows that a run has written."""
    try:
        return len(row_file.read(directory / "unfinished" / "record.rows")[1])
    except (OSError, RecordError):
        return 0


@contextlib.contextmanager
def endless(directory: Path, *more: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Start a run in a directory. It has some rows; it is killed at the end of the block."""
    process = freeflyer("run", SCENARIO, *ENDLESS, "--out", directory, *more, **options)
    with process:
        try:
            until(lambda: rows_in(directory) > 20, process)
            yield process
        finally:
            process.kill()
            process.communicate()


def killed(directory: Path, *more: str) -> None:
    with endless(directory, *more):
        pass


def assert_first_rows(record: Record) -> None:
    """The rows have the same bits as the first rows of a run that ends by itself.

    The last row of an interrupted run is between two others; it is not compared.
    """
    whole = ff.run(
        SCENARIO, {"stop_s": round(float(record.time[-1]) + 1.0, 6), "record.every_s": 0.1}
    ).record
    rows = record.rows - 1
    assert rows > 10
    assert np.array_equal(record.time[:rows], whole.time[:rows])
    assert set(record) == set(whole)
    for name in record:
        assert record[name][:rows].tobytes() == whole[name][:rows].tobytes(), name


def dead(directory: Path) -> None:
    """Replace the process that holds a directory by one that has ended."""
    path = directory / "unfinished" / "process.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "started": "0"}))


def full(*_: object) -> None:
    """Raise the error of a full disk."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def incomplete(directory: Path) -> None:
    """Leave a run whose results could not be written at its end."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Record, "write_file", full)
        with pytest.raises(OutputError, match="No space left"):
            ff.run(SCENARIO, SHORT, directory=directory)


def names(directory: Path) -> set[str]:
    return set(os.listdir(directory))


WHOLE = {"record.parquet", "summary.json"}
"""Files of a finished run."""
