"""Fixtures for robots and FMUs, and the distribution of tests to processes."""

from __future__ import annotations

import os
import resource
import signal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from robots import ROBOTS
from xdist.scheduler import LoadScopeScheduling

from freeflyer_fmus.export.prebuilt import directory
from freeflyer_fmus.robot.robot import Robot
from freeflyer_fmus.robot.urdf import load_robot_file

settings.register_profile(
    "default",
    deadline=None,
    derandomize=True,
    max_examples=50,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
settings.load_profile("default")
# One thread per test process: two processes run in parallel.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Background jobs of a shell ignore SIGINT, and child processes of the tests would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Ignore benchmarks if they are deselected, since they import other projects' simulators."""
    return (
        True
        if collection_path.name == "benchmarks" and "not benchmark" in config.option.markexpr
        else None
    )


def group_of(nodeid: str) -> str:
    """Return the group of tests that run in one process.

    The tests of a file share fixtures. All real-time tests are one group, so that two loops never
    compete for the CPU.
    """
    file = nodeid.partition("::")[0]
    return "real time" if file.split("/")[-2] in ("facility", "recording") else file


class Groups(LoadScopeScheduling):
    """Scheduler that keeps each group on one process.

    `--dist loadgroup` of pytest-xdist 3.8 groups nothing under pytest 9.2.
    """

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Groups:
    return Groups(config, log)


def cpu(those: int) -> float:
    usage = resource.getrusage(those)
    return usage.ru_utime + usage.ru_stime


EARLIER = cpu(resource.RUSAGE_CHILDREN)
"""CPU time of earlier child processes, for example of the shell in `pip install ... && pytest`."""


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    seconds = cpu(resource.RUSAGE_SELF) + cpu(resource.RUSAGE_CHILDREN) - EARLIER
    terminalreporter.write_line(f"{seconds:.0f} s of CPU, with collection and child processes")


@pytest.fixture(scope="session", params=list(ROBOTS))
def any_robot(request: pytest.FixtureRequest) -> Robot:
    return ROBOTS[request.param]()


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot_file()


@pytest.fixture(scope="session")
def fmus() -> Path:
    """Return the directory of the FMUs built at installation."""
    found = directory()
    assert (found / "fmi2" / "free_flyer.fmu").is_file(), (
        "the package was installed without its FMUs"
    )
    return found
