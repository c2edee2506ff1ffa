"""Fixtures: a separate directory of rings for each test, and simulated clocks.

The directory is in memory, as in normal use, and its path is short enough for socket names.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from clocks import Clocks

from freeflyer_adapters.foundation import environment


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    place = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    path = Path(tempfile.mkdtemp(prefix="freeflyer-test-", dir=place))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(path))
    yield path
    shutil.rmtree(path, ignore_errors=True)


@pytest.fixture
def clocks() -> Iterator[Clocks]:
    made = Clocks()
    with environment.within(made):
        yield made
