"""Stops of real processes over sockets: permanent, fast and with a reason."""

from __future__ import annotations

import json
import re
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from processes import BASE_ALONE, PATIENT_FACILITY, PATIENT_LOOP, Rig, activations, events, rig
from small_disk import mounted

from freeflyer_adapters.arm.frames import ArmFrames, FrameMapping, Mode
from freeflyer_adapters.can.link import Receiver, Sender, open_bus
from freeflyer_adapters.can.local_bus import FD_FORMAT, FRAME, directory
from freeflyer_adapters.device.device import LifeCycle

State = dict[str, list[float]]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Rig]:
    with rig(tmp_path) as made:
        yield made


class Commander:
    """A scripted controller of the arm."""

    def __init__(self, channel: str, number: int = 4711) -> None:
        self.frames, self.number = ArmFrames(FrameMapping(), 6), number
        self.bus = open_bus("local", channel, True, [self.frames.state], {})
        self._sender, self._receiver = (
            Sender(self.bus, self.frames.command),
            Receiver(self.frames.state),
        )

    def state(self) -> State:
        """Return the next state frame."""
        while True:
            message = self.bus.recv(2.0)
            assert message is not None, "the arm sends nothing"
            if (numbers := self._receiver.take(message)) is not None:
                return numbers

    def send(self, mode: Mode, answered: float, torque: float = 0.0) -> None:
        self._sender.send({
            "answered_cycle": (answered,),
            "controller": (float(self.number),),
            "mode": (float(self.frames.mode_number(mode)),),
            "joint_torque_command": (torque,) * 6,
        })  # fmt: skip

    def answer(self, mode: Mode, until: Callable[[State], bool]) -> None:
        """Answer every state frame with `mode` until `until` returns True."""
        for _ in range(2000):
            state = self.state()
            if until(state):
                return
            self.send(mode, state["cycle"][0])
        raise AssertionError(f"{mode.name} did not lead to the expected state")

    def life(self, state: State) -> LifeCycle | None:
        return self.frames.life_cycle(state["life_cycle"][0])


def test_frames_after_the_brake_command_cause_no_motion(bench: Rig) -> None:
    """Frames of all modes of the session that has ended are tested."""
    facility = bench.facility(*PATIENT_FACILITY)
    controller = Commander(bench.channel)
    try:
        controller.answer(Mode.reset, lambda s: s["obeyed_controller"] == [4711.0])
        controller.answer(Mode.activate, lambda s: controller.life(s) is LifeCycle.active)
        cycles = iter(range(50))
        controller.answer(Mode.torque, lambda s: next(cycles, None) is None)
        controller.answer(Mode.brake, lambda s: s["brakes"] == [1.0])
        place = controller.state()["joint_position"]
        for mode in (Mode.torque, Mode.activate, Mode.reset, Mode.activate, Mode.torque):
            controller.send(
                mode, controller.state()["cycle"][0], torque=1.0 if mode is Mode.torque else 0.0
            )
            for _ in range(150):
                state = controller.state()
                assert controller.life(state) is LifeCycle.inactive, mode
                assert state["brakes"] == [1.0], mode
                assert state["joint_position"] == pytest.approx(place, abs=1e-6), mode
    finally:
        controller.bus.shutdown()
    report = bench.facility_report(facility)
    assert activations(report, "arm_drive") == 1
    assert report["devices"]["arm_drive"]["commands_outside_active"] >= 3


@pytest.mark.slow
def test_delayed_set_points_do_not_activate_a_stopped_base(
    tmp_path: Path,
) -> None:
    path = tmp_path / "base.toml"
    path.write_text(BASE_ALONE)
    with rig(tmp_path, str(path)) as bench:
        forwarder = bench.forwarder()
        base = f'devices.base_robot.connect=["{bench.endpoint}"]'
        watchdog = ("--set", "facility.base_watchdog_s=0.1")
        facility = bench.start(
            "facility", str(path), "--set", base, *watchdog, "--out", str(tmp_path / "facility")
        )
        facility.wait_for("is there")
        far = f'devices.base_robot.connect=["{forwarder.endpoint}"]'
        loop = bench.start(
            "hil", str(path), "--set", far, *watchdog, "--no-view", "--out", str(tmp_path / "hil")
        )
        facility.wait_for("inactive -> active: set points arrived")
        time.sleep(1.0)
        forwarder.held.set()
        facility.wait_for("active -> safe_stop: no set point for 0.1 s")
        time.sleep(0.8)
        forwarder.held.clear()
        assert loop.finish() == 3
        assert "the base robot does not take set points any more" in loop.text
        time.sleep(1.0)
        report = bench.facility_report(facility)
    assert activations(report, "base_robot") == 1, events(report, "base_robot")


@pytest.mark.slow
def test_set_points_that_arrive_after_the_end_of_their_loop_do_not_activate(
    tmp_path: Path,
) -> None:
    """All set points are delayed from the first one on, so the loop ends without a report."""
    path = tmp_path / "base.toml"
    path.write_text(BASE_ALONE)
    with rig(tmp_path, str(path)) as bench:
        forwarder = bench.forwarder()
        base = f'devices.base_robot.connect=["{bench.endpoint}"]'
        facility = bench.start(
            "facility", str(path), "--set", base, "--out", str(tmp_path / "facility")
        )
        facility.wait_for("is there")
        far = f'devices.base_robot.connect=["{forwarder.endpoint}"]'
        loop = bench.start(
            "hil", str(path), "--set", far, "--no-view", "--out", str(tmp_path / "hil")
        )
        loop.wait_for("Real time:")
        forwarder.held.set()
        code = loop.finish()
        forwarder.held.clear()
        time.sleep(1.0)
        report = bench.facility_report(facility)
    assert code == 2, loop.text
    assert "does not take set points" in loop.text
    assert activations(report, "base_robot") == 0, events(report, "base_robot")


# Time to stop

WATCHDOGS = "[facility]\narm_watchdog_cycles = 500\nbase_watchdog_s = 1.0\n"
"""Longer than real-time throttling of a busy machine (50 ms), but they still detect a hang."""
QUICK_RAMP = "devices.arm_drive.parameters.ramp_down_time=0.001"
"""Short ramp-down, so that the first brake command shows the start of the ramp-down."""
HOLES = (
    "devices.arm_drive.parameters.lost_consecutive=200",
    "devices.arm_drive.parameters.state_age_limit=0.8",
    "devices.base_robot.parameters.lost_consecutive=250",
    "devices.base_robot.parameters.lost_in_window=0",
    "devices.base_robot.parameters.age_limit=1.0",
)


class Flood:
    """Sends frames of another node (300h) at the maximum rate, for at most `longest` [s]."""

    def __init__(self, channel: str, process_id: int, longest: float = 8.0) -> None:
        self.frames = 0
        self._ended = threading.Event()
        self._nodes = []
        for path in directory(channel).glob(f"{process_id}-*"):
            for _ in range(4):
                self._nodes.append(node := socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
                node.setblocking(False)
                node.connect(str(path))
        assert self._nodes
        self._thread = threading.Thread(
            target=self._send, args=(time.monotonic() + longest,), daemon=True
        )
        self._thread.start()

    def _send(self, end: float) -> None:
        packet = FRAME.pack(0x300, 64, FD_FORMAT, 0, 0, bytes(64))
        while not self._ended.is_set() and time.monotonic() < end:
            for node in self._nodes:
                try:
                    for _ in range(100):
                        node.send(packet)
                        self.frames += 1
                except OSError:  # the buffer is full, or the process has ended
                    pass

    def end(self) -> None:
        self._ended.set()
        self._thread.join()
        for node in self._nodes:
            node.close()


def seconds_to_stop(folder: Path, *, flooded: bool) -> tuple[float, float]:
    """Return the times from SIGTERM to the first brake command and to the stop message [s]."""
    folder.mkdir()
    (folder / "lab.toml").write_text(f'extends = "facility"\n{WATCHDOGS}')
    with rig(folder, str(folder / "lab.toml")) as bench:
        facility, listener = bench.facility(), bench.listener()
        loop = bench.hil(*HOLES, QUICK_RAMP, options=("--no-record",))
        facility.wait_for("inactive -> active: commanded")
        bench.wait_for_instants()
        flood = Flood(bench.channel, loop.popen.pid) if flooded else None
        time.sleep(2.0)
        start = time.time()
        loop.send(signal.SIGTERM)
        loop.wait_for("Stop:", timeout=20.0)
        sentence = time.time() - start
        if flood is not None:
            flood.end()
        assert loop.finish() == 3, loop.text
        report = bench.facility_report(facility)
        assert not [event for event in events(report, "arm_drive") if "no command for" in event], (
            loop.text
        )
        assert "interrupted by the user" in loop.text or (
            flooded and "a flood of frames" in loop.text
        ), loop.text
        assert activations(report, "arm_drive") == activations(report, "base_robot") == 1
        ramp = next(at for at, mode in listener.commands if mode is Mode.brake) - start
        print(
            f"{'flood of ' + str(flood.frames) + ' frames' if flood else 'quiet'}: brakes {ramp:.3f} s, sentence {sentence:.2f} s after SIGTERM"
        )
        return ramp, sentence


@pytest.mark.slow
def test_a_flood_of_frames_does_not_delay_the_stop(tmp_path: Path) -> None:
    ramp, quiet = seconds_to_stop(tmp_path / "quiet", flooded=False)
    assert ramp < 0.1
    ramp, flooded = seconds_to_stop(tmp_path / "flooded", flooded=True)
    assert ramp < 0.1
    assert flooded < quiet + 2.0


# The stop message


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 3 MiB."""
    with mounted(tmp_path / "small", "3m") as place:
        yield place


@pytest.mark.slow
def test_with_a_full_disk_the_reason_is_printed_once_and_stop_json_is_complete(
    bench: Rig, small_disk: Path
) -> None:
    facility = bench.facility(*PATIENT_FACILITY)
    loop = bench.hil(*PATIENT_LOOP, out="small/out")
    facility.wait_for("inactive -> active: commanded")
    bench.wait_for_instants("small/out")
    (small_disk / "ballast").write_bytes(bytes(2 << 20))
    time.sleep(4.0)
    with pytest.raises(OSError, match="No space left"):
        (small_disk / "more").write_bytes(bytes(4 << 20))
    loop.send(signal.SIGINT)
    assert loop.finish() != 0
    lines = [line for line in loop.output if line.startswith("Stop:")]
    assert len(lines) == 1, loop.text
    assert re.match(
        r"Stop: interrupted by the user; all devices were brought to rest in \d", lines[0]
    )
    # The recorder may report its file earlier. The loop reports files only after the message.
    before, after = loop.text.split(lines[0])
    assert "record.parquet" not in before
    assert "record.parquet" in after
    stop = json.loads((small_disk / "out" / "stop.json").read_text())
    assert stop["stopped"] is True
    assert stop["orderly"] is True
    assert f"Stop: {stop['reason']}; {stop['left']}" == lines[0]
