"""The virtual facility as a process of a script: nothing remains, however the script ends."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from processes import free_port

import freeflyer as ff
from freeflyer_adapters import VirtualFacility

SCRIPT = """
import sys, time
from freeflyer_adapters import VirtualFacility
with VirtualFacility("facility", sys.argv[1:]) as facility:
    print("ready", facility._process.pid, facility._folder.path.parent, flush=True)
    time.sleep(60.0)
"""


def settings() -> list[str]:
    port = free_port()
    return [
        f"devices.arm_drive.channel=script-{port}",
        f'devices.base_robot.connect=["tcp/127.0.0.1:{port}"]',
    ]


def test_the_facility_reports_after_its_context() -> None:
    with VirtualFacility("facility", settings()) as facility:
        assert "is there" in facility.lines[-1]
    assert facility.report["scenario"] == "facility"


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_no_facility_remains_after_its_script(number: signal.Signals) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT, *settings()], stdout=subprocess.PIPE, text=True
    ) as script:
        assert script.stdout is not None
        line = script.stdout.readline().split()
        script.send_signal(number)
    process = Path("/proc") / line[1]
    end = time.monotonic() + 20.0
    while process.exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert not process.exists()
    assert not Path(line[2]).exists()


@pytest.mark.parametrize(
    ("scenario", "expected"),
    [
        (None, "the scenario is None"),
        ("facilty", "did you mean 'facility'"),
        ("robust", "has no .devices.NAME."),
    ],
)
def test_a_facility_that_cannot_start_is_one_sentence(scenario: str, expected: str) -> None:
    with (
        pytest.raises(ff.CosimError, match=expected) as caught,
        VirtualFacility(scenario, settings() if scenario != "robust" else ()),
    ):
        pass
    assert "\n" not in str(caught.value)
