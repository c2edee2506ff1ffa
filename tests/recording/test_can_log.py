"""CAN log: the readers of python-can find every frame, also in a log that was not finished."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest

from freeflyer_adapters.can.local_bus import LocalBus
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.recording.can_log import FORMATS, CanLog
from freeflyer_adapters.recording.client import can_channels
from freeflyer_adapters.recording.ring_header import CanChannel
from freeflyer_adapters.recording.wall_clock import WallClock

FRAMES = 200
READERS: dict[str, Callable[[Path], Any]] = {
    "blf": can.BLFReader,
    "asc": lambda path: can.ASCReader(path, base="hex"),
}


def channel(name: str) -> CanChannel:
    return CanChannel(name="arm", interface="local", channel=name, is_fd=True)


def sent(i: int) -> can.Message:
    """Return frames of all kinds that can occur on the channel of an arm."""
    if i % 3 == 0:
        return can.Message(
            arbitration_id=0x100 + i, is_extended_id=False, data=bytes([i % 256] * 8)
        )
    return can.Message(
        arbitration_id=0x181,
        is_extended_id=i % 2 == 0,
        is_fd=True,
        bitrate_switch=True,
        data=bytes([i % 256] * 64),
    )


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("killed", [False, True], ids=["closed", "killed"])
def test_a_log_has_every_frame_in_order(
    form: str, killed: bool, tmp_path: Path, runtime: Path
) -> None:
    path, copy = tmp_path / f"can.{form}", tmp_path / f"copy.{form}"
    log = CanLog(channel("log"), path, WallClock.start())
    with LocalBus("log", fd=True) as node:
        for first in range(0, FRAMES, 50):
            for i in range(first, first + 50):
                node.send(sent(i))
            log.take()
    shutil.copy(path, copy)  # the file of a logger that is killed now
    log.close()
    frames = list(READERS[form](copy if killed else path))
    assert log.frames == len(frames) == FRAMES
    for i, frame in enumerate(frames):
        expected = sent(i)
        assert (frame.arbitration_id, frame.is_extended_id, frame.is_fd) == (
            expected.arbitration_id, expected.is_extended_id, expected.is_fd
        )  # fmt: skip
        assert bytes(frame.data) == bytes(expected.data)


def test_the_times_of_a_killed_log_are_those_of_the_frames(tmp_path: Path, runtime: Path) -> None:
    path = tmp_path / "can.blf"
    log = CanLog(channel("times"), path, WallClock.start())
    moments = []
    with LocalBus("times", fd=True) as node:
        for i in range(50):
            before = time.time()
            node.send(sent(i))
            moments.append((before, time.time()))
        log.take()
    # The kernel stamps a frame while it is sent. The log stores its start in whole milliseconds,
    # and the process can be preempted between reading two clocks. Without the start the times
    # would be wrong by decades.
    for frame, (before, after) in zip(can.BLFReader(path), moments, strict=True):
        assert before - 0.02 <= frame.timestamp <= after + 0.02
    log.close()


def test_a_channel_that_cannot_be_opened_raises_an_error(tmp_path: Path, runtime: Path) -> None:
    with pytest.raises(DeviceError, match="cannot be opened"):
        CanLog(channel("no/such"), tmp_path / "can.blf")
    assert list(tmp_path.iterdir()) == []


def test_every_channel_of_the_devices_is_logged_once() -> None:
    def device(name: str, options: object) -> Any:
        return SimpleNamespace(name=name, options=options, frames=SimpleNamespace(is_fd=True))

    shared = SimpleNamespace(interface="socketcan", channel="can0", bus={"bitrate": 1_000_000})
    found = can_channels(
        [device("a", shared), device("b", shared), device("c", None), SimpleNamespace(name="d")]
    )  # type: ignore[list-item]
    assert found == [
        CanChannel(
            name="a", interface="socketcan", channel="can0", is_fd=True, bus={"bitrate": 1_000_000}
        )
    ]
