"""Contract of a python-can bus, tested on the local and on python-can's virtual interface."""

from __future__ import annotations

import itertools
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import can
import pytest

from freeflyer_adapters.can.local_bus import directory

Opener = Callable[..., can.BusABC]
numbers = itertools.count()


@pytest.fixture(params=["local", "virtual"])
def opened(request: pytest.FixtureRequest) -> Iterator[Opener]:
    channel, buses = f"test-{os.getpid()}-{next(numbers)}", []

    def opener(**options: object) -> can.BusABC:
        options = {"fd": True, **options}
        if request.param == "virtual" and options.pop("fd"):
            options["protocol"] = can.CanProtocol.CAN_FD
        bus = can.Bus(interface=request.param, channel=channel, **options)
        buses.append(bus)
        return bus

    yield opener
    for bus in buses:
        bus.shutdown()


@pytest.fixture
def local() -> Iterator[Opener]:
    channel, buses = f"test-{os.getpid()}-{next(numbers)}", []

    def opener(**options: object) -> can.BusABC:
        bus = can.Bus(interface="local", channel=channel, **{"fd": True, **options})  # type: ignore[arg-type]
        buses.append(bus)
        return bus

    yield opener
    for bus in buses:
        bus.shutdown()


FRAMES = [
    can.Message(arbitration_id=0x123, is_extended_id=False, data=[1, 2, 3]),
    can.Message(arbitration_id=0x7FF, is_extended_id=False, data=[]),
    can.Message(arbitration_id=0x1ABCDEFF, is_extended_id=True, data=range(8)),
    can.Message(arbitration_id=0x100, is_extended_id=False, is_remote_frame=True, dlc=4),
    can.Message(arbitration_id=0x101, is_extended_id=False, is_fd=True, data=range(64)),
    can.Message(
        arbitration_id=0x102, is_extended_id=False, is_fd=True, bitrate_switch=True, data=range(12)
    ),
    can.Message(
        arbitration_id=0x103,
        is_extended_id=False,
        is_fd=True,
        error_state_indicator=True,
        data=range(48),
    ),
    can.Message(arbitration_id=0, is_extended_id=False, is_error_frame=True, data=range(8)),
]


@pytest.mark.parametrize("frame", FRAMES, ids=str)
def test_a_frame_arrives_as_it_was_sent(opened: Opener, frame: can.Message) -> None:
    sender, receiver = opened(), opened()
    before = time.time()
    sender.send(frame)
    found = receiver.recv(2.0)
    assert found is not None
    assert found.equals(frame, timestamp_delta=None, check_channel=False, check_direction=False)
    assert found.is_rx
    assert before - 1e-3 <= found.timestamp <= time.time() + 1e-3


def test_a_sender_receives_own_frames_only_on_request(opened: Opener) -> None:
    without_own, with_own = opened(), opened(receive_own_messages=True)
    without_own.send(FRAMES[0])
    assert with_own.recv(2.0) is not None
    assert without_own.recv(0.0) is None
    with_own.send(FRAMES[0])
    own = with_own.recv(2.0)
    assert own is not None
    assert not own.is_rx


def test_every_peer_receives_all_frames_in_the_order_of_the_sender(opened: Opener) -> None:
    buses = [opened() for _ in range(4)]
    for k in range(20):
        buses[0].send(can.Message(arbitration_id=k, is_extended_id=False))
    for bus in buses[1:]:
        assert [m.arbitration_id for m in iter(lambda bus=bus: bus.recv(0.2), None)] == list(
            range(20)
        )
    buses[3].send(FRAMES[0])
    assert all(bus.recv(1.0) is not None for bus in buses[:3])


def test_filters_pass_only_matching_frames(opened: Opener) -> None:
    sender = opened()
    receiver = opened(can_filters=[{"can_id": 0x181, "can_mask": 0x7FF, "extended": False}])
    for identifier in (0x180, 0x181, 0x182):
        sender.send(can.Message(arbitration_id=identifier, is_extended_id=False))
    sender.send(can.Message(arbitration_id=0x181, is_extended_id=True))
    found = [m.arbitration_id for m in iter(lambda: receiver.recv(0.2), None)]
    assert found == [0x181]
    receiver.set_filters(None)
    sender.send(can.Message(arbitration_id=0x182, is_extended_id=False))
    assert receiver.recv(1.0) is not None


def test_a_timeout_is_kept(opened: Opener) -> None:
    bus = opened()
    for timeout in (0.0, 0.2):
        start = time.monotonic()
        assert bus.recv(timeout) is None
        assert timeout <= time.monotonic() - start + 1e-3 < timeout + 1.0


def test_shutting_down_twice_is_harmless(opened: Opener) -> None:
    bus = opened()
    bus.shutdown()
    bus.shutdown()
    with pytest.raises(can.CanOperationError):
        bus.send(FRAMES[0])


def test_a_notifier_gets_every_frame(opened: Opener) -> None:
    sender, receiver = opened(), opened()
    listener = can.BufferedReader()
    with can.Notifier(receiver, [listener], timeout=0.1):
        for k in range(50):
            sender.send(can.Message(arbitration_id=k, is_extended_id=False))
        found = [listener.get_message(1.0) for _ in range(50)]
    assert [m.arbitration_id for m in found if m is not None] == list(range(50))


# Properties of the local interface only


def test_a_classic_node_neither_sends_nor_receives_fd_frames(local: Opener) -> None:
    fd, classic = local(), local(fd=False)
    fd.send(FRAMES[4])
    fd.send(FRAMES[0])
    found = classic.recv(1.0)
    assert found is not None
    assert not found.is_fd
    with pytest.raises(can.CanOperationError, match="without fd=True"):
        classic.send(FRAMES[4])


def test_the_file_descriptor_stays_readable_while_frames_are_pending(local: Opener) -> None:
    sender, receiver = local(), local()
    receiver.peers  # noqa: B018  accepts the connection
    for _ in range(3):
        sender.send(FRAMES[0])
    for _ in range(3):
        assert select.select([receiver], [], [], 1.0)[0]
        assert receiver.recv(0.0) is not None
    assert not select.select([receiver], [], [], 0.05)[0]


def test_a_peer_that_does_not_read_loses_frames_and_blocks_no_other_peer(local: Opener) -> None:
    sender, reader, _sleeper = local(), local(), local()
    start = time.monotonic()
    for _ in range(2000):
        sender.send(FRAMES[4])
        assert reader.recv(1.0) is not None
    assert sender.dropped > 0  # type: ignore[attr-defined]
    assert time.monotonic() - start < 30.0


def test_a_killed_peer_is_removed_with_its_socket(local: Opener) -> None:
    here = local()
    code = (
        "import can, sys, time\n"
        f"bus = can.Bus(interface='local', channel={here.channel_info.split(chr(39))[1]!r}, fd=True)\n"
        "bus.recv(10); print('got it', flush=True); time.sleep(60)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True
    ) as process:
        deadline = time.monotonic() + 30.0
        while here.peers == 0 and time.monotonic() < deadline:  # type: ignore[attr-defined]
            time.sleep(0.01)
        here.send(FRAMES[0])
        assert process.stdout is not None
        assert process.stdout.readline() == "got it\n"
        process.send_signal(signal.SIGKILL)
        process.wait()
    here.send(FRAMES[0])
    assert here.recv(0.1) is None
    assert here.peers == 0  # type: ignore[attr-defined]
    newcomer = local()  # removes the socket of the killed process
    newcomer.send(FRAMES[0])
    assert here.recv(1.0) is not None
    folder = directory(here.channel_info.split("'")[1])
    assert len([path for path in folder.iterdir() if path.name != "lock"]) == 2


def test_the_directory_of_a_channel_is_private(local: Opener) -> None:
    bus = local()
    folder = directory(bus.channel_info.split("'")[1])
    assert folder.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize("channel", ["", "a/b", "..", "x" * 100, "a b"])
def test_an_invalid_channel_name_is_rejected(channel: str) -> None:
    with pytest.raises(can.CanInitializationError):
        can.Bus(interface="local", channel=channel)


def test_python_can_finds_the_local_interface() -> None:
    assert "local" in can.VALID_INTERFACES


def test_a_filtered_frame_does_not_end_a_recv_with_timeout_zero(local: Opener) -> None:
    sender = local()
    receiver = local(can_filters=[{"can_id": 0x181, "can_mask": 0x7FF, "extended": False}])
    for identifier in (0x200, 0x201, 0x181):
        sender.send(can.Message(arbitration_id=identifier, is_extended_id=False))
    found = receiver.recv(0.0)
    assert found is not None
    assert found.arbitration_id == 0x181


def test_the_last_frames_of_a_node_with_unread_frames_arrive(
    opened: Opener,
) -> None:
    """Example: the last brake command of a controller that has not read all state frames."""
    leaving, staying = opened(), opened()
    staying.send(FRAMES[4])
    leaving.send(FRAMES[0])
    leaving.shutdown()
    found = staying.recv(1.0)
    assert found is not None
    assert found.arbitration_id == FRAMES[0].arbitration_id


def test_the_last_frames_of_a_node_arrive_after_the_receiver_has_sent(
    opened: Opener,
) -> None:
    leaving, staying = opened(), opened()
    leaving.send(FRAMES[0])
    leaving.shutdown()
    staying.send(FRAMES[4])
    found = staying.recv(1.0)
    assert found is not None
    assert found.arbitration_id == FRAMES[0].arbitration_id
