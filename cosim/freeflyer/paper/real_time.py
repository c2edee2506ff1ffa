"""The facility experiment over real bytes: the virtual facility and the loop as commands of their own, as a user would start them.

How they do it is not known here; what they write is read.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from freeflyer.foundation.errors import DONE, STOPPED, OutputError
from freeflyer.master.master import Outcome
from freeflyer.master.record import Record
from freeflyer.scenario.experiment import Result
from freeflyer.scenario.scenario import Scenario

COMMAND = (sys.executable, "-P", "-m", "freeflyer.cli.main")
WRITTEN = ("record.parquet", "summary.json", "facility.json")
CASES = ("facility", "facility_without_pc")


def run(scenario: Scenario, directory: Path, settings: Sequence[str] = ()) -> Result:
    """Starts a facility, runs the loop on it, and stops it; `settings` as for `--set`. What was recorded is the result, also of a loop that stopped early.

    Raises OutputError, with the command's own words, if there is no result.
    """
    settings = [
        *settings,
        f'devices.arm_drive.channel="reproduce-{os.getpid()}"',
        f'devices.base_robot.connect=["tcp/127.0.0.1:{_free_port()}"]',
    ]
    arguments = [scenario.name, *(word for setting in settings for word in ("--set", setting))]
    for name in WRITTEN:  # what an earlier run has left must not be taken for this one's
        with contextlib.suppress(FileNotFoundError):
            (directory / name).unlink()
    with _facility([*COMMAND, "facility", *arguments, "--out", str(directory)]):
        loop = subprocess.run(
            [*COMMAND, "hil", *arguments, "--no-view", "--out", str(directory)],
            capture_output=True,
            text=True,
        )
    if loop.returncode not in (DONE, STOPPED):
        raise OutputError(f"the loop of {scenario.name} did not run: {loop.stderr.strip()}")
    try:
        summary = json.loads((directory / "summary.json").read_text())
        record = Record.read(directory / "record.parquet")
    except OSError as error:
        raise OutputError(
            f"the loop of {scenario.name} left no result: {loop.stderr.strip() or error}"
        ) from error
    outcome = Outcome(
        record=record,
        **{key: summary[f"{key}_s"] for key in ("simulated", "wall")},
        **{key: summary[key] for key in ("steps", "diverged", "failed", "cause", "interrupted")},
    )
    return Result(scenario=scenario, outcome=outcome, errors={}, summary=summary)


@contextlib.contextmanager
def _facility(command: list[str]) -> Iterator[None]:
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        try:
            said = ""
            for line in process.stdout:
                said = line.strip()
                if "is there" in line:
                    break
            else:
                raise OutputError(f"the virtual facility did not start: {said}")
            yield
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                process.communicate(timeout=10.0)
            except subprocess.TimeoutExpired:
                process.kill()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
