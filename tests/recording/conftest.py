"""Each test's own place for rings, short enough for the names of sockets, and in memory as in earnest; and clocks that it sets."""

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
