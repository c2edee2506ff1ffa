"""Robots and FMUs that the tests share, and how tests are shared out to processes."""

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
# One thread a test process: two of them run side by side.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# A shell's background jobs ignore Ctrl-C, and so would every process that the tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Benchmarks import other projects' simulators: not for a run that leaves them out."""
    return (
        True
        if collection_path.name == "benchmarks" and "not benchmark" in config.option.markexpr
        else None
    )


def group_of(nodeid: str) -> str:
    """A file's tests share what they build; all that run in real time share one process, so that two loops never compete."""
    file = nodeid.partition("::")[0]
    return "real time" if file.split("/")[-2] in ("facility", "recording") else file


class Groups(LoadScopeScheduling):
    """Each group stays on one process. (`--dist loadgroup` of pytest-xdist 3.8 groups nothing under pytest 9.2.)"""

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Groups:
    return Groups(config, log)


def cpu(those: int) -> float:
    usage = resource.getrusage(those)
    return usage.ru_utime + usage.ru_stime


EARLIER = cpu(resource.RUSAGE_CHILDREN)
"""Of what a shell did before it became this process: `pip install ... && pytest`."""


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
    """The FMUs built at install."""
    found = directory()
    assert (found / "fmi2" / "free_flyer.fmu").is_file(), (
        "the package was installed without its FMUs"
    )
    return found
