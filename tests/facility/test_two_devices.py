"""A second arm or base is reported before activation, and stops a running loop."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from commands import run_command
from processes import (
    BASE_ALONE,
    PATIENT_FACILITY,
    PATIENT_LOOP,
    Process,
    Rig,
    activations,
    free_port,
    rig,
)

from freeflyer_adapters.base.link import OdometryLink
from freeflyer_adapters.base.options import LinkOptions
from freeflyer_adapters.base.session import open_session

TWO_ARMS = "two senders send the state frame .*two arms are on this channel; switch one of them off"
START = np.array([0.04, 0.0, 0.08]), np.array([0.0871557427, 0.0, 0.0, 0.9961946981])


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Rig]:
    with rig(tmp_path) as made:
        yield made


def second_facility(bench: Rig, channel: str) -> Process:
    """Start a second facility on `channel` with a separate port, without waiting for it."""
    base = f'devices.base_robot.connect=["tcp/127.0.0.1:{free_port()}"]'
    sets = [
        argument
        for s in (*PATIENT_FACILITY, base, f'devices.arm_drive.channel="{channel}"')
        for argument in ("--set", s)
    ]
    return bench.start("facility", bench.scenario, *sets)


def test_two_arms_on_one_channel_are_reported_and_not_activated(bench: Rig) -> None:
    """All limits have their defaults."""
    other = second_facility(bench, bench.channel)
    facility = bench.facility()
    other.wait_for("is there")
    loop = bench.hil()
    assert loop.finish() == 2, loop.text
    assert re.search(TWO_ARMS, " ".join(loop.output)), loop.text
    time.sleep(0.3)
    for process in (facility, other):
        process.send(signal.SIGINT)
        assert process.finish() == 0
        assert "-> active" not in process.text, process.text


@pytest.mark.slow
def test_a_second_arm_stops_the_running_loop_and_is_reported(bench: Rig) -> None:
    facility = bench.facility(*PATIENT_FACILITY)
    loop = bench.hil(*PATIENT_LOOP)
    facility.wait_for("inactive -> active: commanded")
    bench.wait_for_instants()
    other = second_facility(bench, bench.channel)
    assert loop.finish() == 3, loop.text
    assert re.search(f"Stop: arm_drive: {TWO_ARMS}", " ".join(loop.output)), loop.text
    other.send(signal.SIGINT)
    assert other.finish() == 0
    assert "-> active" not in other.text
    assert activations(bench.facility_report(facility), "arm_drive") == 1


@pytest.mark.slow
def test_two_base_robots_on_one_topic_are_reported_and_not_commanded(
    tmp_path: Path,
) -> None:
    path = tmp_path / "base.toml"
    path.write_text(BASE_ALONE)
    with rig(tmp_path, str(path)) as bench:
        endpoints = [bench.endpoint, f"tcp/127.0.0.1:{free_port()}"]
        both = [
            bench.start("facility", str(path), "--set", f'devices.base_robot.connect=["{e}"]')
            for e in endpoints
        ]
        for process in both:
            process.wait_for("is there")
        connect = f'devices.base_robot.connect=["{endpoints[0]}", "{endpoints[1]}"]'
        loop = bench.start(
            "hil", str(path), "--set", connect, "--no-view", "--out", str(tmp_path / "hil")
        )
        assert loop.finish() == 2, loop.text
        named = re.search(
            r"(two publishers send topic base_robot/measured: |sessions )(\w+) and (\w+).*there are two base robots; stop one of them",
            " ".join(loop.output),
        )
        assert named, loop.text
        assert named[2] != named[3]
        time.sleep(0.3)
        for process in both:
            process.send(signal.SIGINT)
            assert process.finish() == 0
            assert "->" not in process.text, process.text


@pytest.mark.slow
def test_a_second_base_robot_stops_the_running_loop_and_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "base.toml"
    path.write_text(BASE_ALONE)
    with rig(tmp_path, str(path)) as bench:
        base, endpoint = (
            f'devices.base_robot.connect=["{bench.endpoint}"]',
            f"tcp/127.0.0.1:{free_port()}",
        )
        facility = bench.start(
            "facility", str(path), "--set", base, "--set", "facility.base_watchdog_s=1.0"
        )
        facility.wait_for("is there")
        listen = f'devices.base_robot.listen=["{endpoint}"]'
        loop = bench.start(
            "hil",
            str(path),
            "--set",
            base,
            "--set",
            listen,
            "--no-view",
            "--out",
            str(tmp_path / "hil"),
        )
        facility.wait_for("set points arrived")
        bench.wait_for_instants()
        # The second base robot publishes to the controller's own endpoint.
        options = LinkOptions(connect=(endpoint,))
        session = open_session(options.connect, options.listen, "second")
        link = OdometryLink(session, options, options.measured_topic, options.setpoint_topic)
        try:
            end = time.monotonic() + 10.0
            while loop.popen.poll() is None and time.monotonic() < end:
                link.publish(*START, np.zeros(6))
                time.sleep(0.004)
        finally:
            names = link.identity, link.gid
            link.close()
            session.close()
        assert loop.finish() == 3, loop.text
        text = " ".join(loop.output)
        assert re.search(
            "Stop: base_robot: (session .* starts to publish|two publishers send) topic base_robot/measured",
            text,
        )
        assert any(name in text for name in names), text


@pytest.mark.slow
def test_a_base_with_other_frames_is_rejected_by_a_check_with_both_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "base.toml"
    path.write_text(BASE_ALONE)
    with rig(tmp_path, str(path)) as bench:
        base = f'devices.base_robot.connect=["{bench.endpoint}"]'
        theirs = ('devices.base_robot.frame="odom"', 'devices.base_robot.child_frame="tool0"')
        facility = bench.start(
            "facility", str(path), *(a for s in (base, *theirs) for a in ("--set", s))
        )
        facility.wait_for("is there")
        patience = "devices.base_robot.parameters.configure_timeout=1.0"
        code, error = run_command(
            capsys, "hil", str(path), "--check", "--set", base, "--set", patience
        )
        assert code == 2
        assert (
            "a pose of 'tool0' in 'odom' (child_frame_id, header.frame_id); 'base' in 'inertial' is expected"
            in error
        )
        facility.send(signal.SIGINT)
        assert facility.finish() == 0
        assert "->" not in facility.text
