"""The facility experiment in real time.

The virtual facility and the control loop are started as separate commands, in the same way as a
user starts them. This module uses only the files, the printed lines and the exit codes of these
commands.
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

from freeflyer.foundation.errors import OutputError, RecordError
from freeflyer.foundation.exit_codes import DONE, STOPPED
from freeflyer.master.master import Outcome
from freeflyer.master.record import Record
from freeflyer.scenario.experiment import Result
from freeflyer.scenario.scenario import Scenario

COMMAND = (sys.executable, "-P", "-m", "freeflyer.cli.main")
CASES = ("facility", "facility_without_pc")


def run(scenario: Scenario, directory: Path, settings: Sequence[str] = ()) -> Result:
    """Start a virtual facility, run the control loop on it, and stop the facility.

    `settings` are further arguments of `--set`. A loop that stopped early also gives a result.
    Raises OutputError if the loop gives no result. The message contains the error output of the
    loop. Also raises OutputError if the facility does not start.
    """
    # Only this process uses this CAN channel and this TCP port. Therefore several runs at the same
    # time do not interfere.
    settings = [
        *settings,
        f'devices.arm_drive.channel="reproduce-{os.getpid()}"',
        f'devices.base_robot.connect=["tcp/127.0.0.1:{_free_port()}"]',
    ]
    arguments = [scenario.name, *(part for setting in settings for part in ("--set", setting))]
    with _facility([*COMMAND, "facility", *arguments, "--out", str(directory)]):
        loop = subprocess.run(
            [*COMMAND, "hil", *arguments, "--no-view", "--overwrite", "--out", str(directory)],
            capture_output=True,
            text=True,
        )
    # Read the result from the files of the loop.
    if loop.returncode not in (DONE, STOPPED):
        raise OutputError(f"the loop of {scenario.name} did not run: {loop.stderr.strip()}")
    try:
        summary = json.loads((directory / "summary.json").read_text())
        record = Record.read(directory / "record.parquet")
    except (OSError, RecordError) as error:
        raise OutputError(
            f"the loop of {scenario.name} wrote no result: {loop.stderr.strip() or error}"
        ) from error
    outcome = Outcome(
        record=record,
        **{key: summary[f"{key}_s"] for key in ("simulated", "wall")},
        **{key: summary[key] for key in ("steps", "diverged", "failed", "cause", "interrupted")},
    )
    return Result(scenario=scenario, outcome=outcome, errors={}, summary=summary)


@contextlib.contextmanager
def _facility(command: list[str]) -> Iterator[None]:
    """Start a facility, wait until it is ready, and stop it when the context ends.

    The facility is ready when it prints a line that contains "is there".
    Raises OutputError if the facility does not start.
    """
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        try:
            last = ""
            for line in process.stdout:
                last = line.strip()
                if "is there" in line:
                    break
            else:
                raise OutputError(f"the virtual facility did not start: {last}")
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
