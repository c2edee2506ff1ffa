"""Robots and FMUs that the tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from robots import ROBOTS

from freeflyer_fmus.prebuilt_fmus import directory
from freeflyer_fmus.robot import Robot
from freeflyer_fmus.urdf import load_robot_file

settings.register_profile(
    "default", deadline=None, derandomize=True, max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
settings.load_profile("default")
# One thread a test process: two of them run side by side.
os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A file's tests stay on one process; all that run in real time share one, so that two loops never fight for the cores."""
    for item in items:
        group = "real time" if item.path.parent.name in ("facility", "recording") else str(item.path)
        item.add_marker(pytest.mark.xdist_group(group))


@pytest.fixture(scope="session", params=list(ROBOTS))
def any_robot(request: pytest.FixtureRequest) -> Robot:
    return ROBOTS[request.param]()


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot_file()


@pytest.fixture(scope="session")
def fmus() -> Path:
    """The FMUs built at install."""
    found = directory()
    assert (found / "fmi2" / "free_flyer.fmu").is_file(), "the package was installed without its FMUs"
    return found
