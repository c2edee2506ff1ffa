"""A virtual facility and controllers as processes, with a separate channel and port per test."""

from __future__ import annotations

import itertools
import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas

from freeflyer.foundation.errors import RecordError
from freeflyer_adapters.arm.frames import ArmFrames, FrameMapping, Mode
from freeflyer_adapters.can.link import open_bus
from freeflyer_adapters.device.device import LifeCycle
from freeflyer_adapters.recording.ring import RingReader
from freeflyer_adapters.recording.ring import folder as rings

COMMAND = (sys.executable, "-m", "freeflyer.cli.main")
numbers = itertools.count()
# A shared machine may suspend these processes. With these settings, gaps of up to a second are
# counted and do not stop the loop. The rules themselves are tested without a clock (tests/links).
PATIENT_FACILITY = ("facility.arm_watchdog_cycles=1000", "facility.base_watchdog_s=1.0")
PATIENT_ARM = (
    "devices.arm_drive.parameters.lost_consecutive=1000",
    "devices.arm_drive.parameters.state_age_limit=1.0",
    "devices.arm_drive.parameters.watchdog_cycles=1000",
)
PATIENT_BASE = (
    "devices.base_robot.parameters.lost_consecutive=250",
    "devices.base_robot.parameters.lost_in_window=0",
    "devices.base_robot.parameters.age_limit=1.0",
    "devices.base_robot.parameters.watchdog=1.0",
)
PATIENT_LOOP = (*PATIENT_ARM, *PATIENT_BASE)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Process:
    """A running command. `output` contains the lines that were read."""

    def __init__(self, arguments: Sequence[str]) -> None:
        self.popen = subprocess.Popen(
            [*COMMAND, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self._lines: queue.Queue[str | None] = queue.Queue()
        self.output: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.popen.stdout is not None
        for line in self.popen.stdout:
            self._lines.put(line.rstrip("\n"))
        self._lines.put(None)

    def wait_for(self, text: str, timeout: float = 30.0) -> str:
        """Read lines until one contains `text`, and return it."""
        end = time.monotonic() + timeout
        while True:
            try:
                line = self._lines.get(timeout=max(0.01, end - time.monotonic()))
            except queue.Empty:
                raise AssertionError(
                    f"{text!r} was not printed within {timeout} s, but:\n" + "\n".join(self.output)
                ) from None
            if line is None:
                raise AssertionError(f"{text!r} was not printed, but:\n" + "\n".join(self.output))
            self.output.append(line)
            if text in line:
                return line

    def finish(self, timeout: float = 60.0) -> int:
        """Read all lines and return the exit code."""
        code = self.popen.wait(timeout)
        while (line := self._lines.get(timeout=10.0)) is not None:
            self.output.append(line)
        assert not any("Traceback" in line for line in self.output), "\n".join(self.output)
        return code

    @property
    def text(self) -> str:
        return "\n".join(self.output)

    def send(self, number: int) -> None:
        self.popen.send_signal(number)

    def end(self) -> None:
        if self.popen.poll() is None:
            self.popen.kill()
        self.popen.wait()
        self._reader.join(5.0)
        assert self.popen.stdout is not None
        self.popen.stdout.close()


BASE_ALONE = """extends = "facility"
[devices.arm_drive]
kind = "simulated"
[devices.base_robot.parameters]
lost_consecutive = 250
lost_in_window = 0
age_limit = 1.0
watchdog = 1.0
"""
"""A scenario with a simulated arm in the controller process: only the base is on a link."""


@dataclass(frozen=True)
class State:
    """A state frame. `at` is the stamp of the kernel [s of the wall clock]."""

    at: float
    life: LifeCycle | None
    brakes: bool

    @property
    def has_power(self) -> bool:
        return self.life is LifeCycle.active or not self.brakes


class Listener:
    """A node on the CAN channel with a thread that receives all frames.

    `states` contains the state frames, and `commands` the pairs (time, mode) of the command frames.
    """

    def __init__(self, channel: str) -> None:
        self.frames = ArmFrames(FrameMapping(), 6)
        self.states: list[State] = []
        self.commands: list[tuple[float, Mode | None]] = []
        self._bus = open_bus("local", channel, True, [self.frames.state, self.frames.command], {})
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        state, command = self.frames.state, self.frames.command
        while not self._ended.is_set():
            message = self._bus.recv(0.1)
            if message is not None and message.arbitration_id == state.identifier:
                numbers = state.unpack(message.data)
                self.states.append(
                    State(
                        message.timestamp,
                        self.frames.life_cycle(numbers["life_cycle"][0]),
                        numbers["brakes"][0] > 0.5,
                    )
                )
            elif message is not None:
                self.commands.append(
                    (message.timestamp, self.frames.mode(command.unpack(message.data)["mode"][0]))
                )

    def after_the_first_brake(self) -> list[State]:
        """Return all states from the first engaged brake on, after the arm has had power."""
        first = next(k for k, state in enumerate(self.states) if state.has_power)
        braked = next(k for k, state in enumerate(self.states) if k > first and state.brakes)
        return self.states[braked:]

    def end(self) -> None:
        self._ended.set()
        self._thread.join()
        self._bus.shutdown()


class Forwarder:
    """A TCP forwarder to a local port. While `held` is set, incoming data is delayed."""

    def __init__(self, port: int) -> None:
        self.held = threading.Event()
        self._target = port
        self._server = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        self._ends = [self._server]
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._server.accept()
                far = socket.create_connection(("127.0.0.1", self._target))
                self._ends += [near, far]
                for end in (near, far):
                    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self._forward, args=(near, far, True), daemon=True).start()
                threading.Thread(target=self._forward, args=(far, near, False), daemon=True).start()

    def _forward(self, source: socket.socket, target: socket.socket, inwards: bool) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                while inwards and self.held.is_set():
                    time.sleep(0.002)
                target.sendall(data)
            target.shutdown(socket.SHUT_WR)

    def end(self) -> None:
        for end in self._ends:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()


class Rig:
    """One facility and the processes that are started with it."""

    def __init__(self, folder: Path, scenario: str = "facility") -> None:
        self.folder, self.scenario = folder, scenario
        self.channel = f"test-{os.getpid()}-{next(numbers)}"
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.started: list[Process] = []
        self.ends: list[Listener | Forwarder] = []

    @property
    def links(self) -> list[str]:
        settings = (
            f'devices.arm_drive.channel="{self.channel}"',
            f'devices.base_robot.connect=["{self.endpoint}"]',
        )
        return [argument for setting in settings for argument in ("--set", setting)]

    def start(self, *arguments: str) -> Process:
        process = Process(arguments)
        self.started.append(process)
        return process

    def facility(self, *settings: str) -> Process:
        sets = [argument for setting in settings for argument in ("--set", setting)]
        process = self.start(
            "facility", self.scenario, *self.links, *sets, "--out", str(self.folder / "facility")
        )
        process.wait_for("is there")
        return process

    def hil(self, *settings: str, options: Sequence[str] = (), out: str = "hil") -> Process:
        sets = [argument for setting in settings for argument in ("--set", setting)]
        out = str(self.folder / out)
        return self.start(
            "hil", self.scenario, *self.links, *sets, "--no-view", "--out", out, *options
        )

    def listener(self) -> Listener:
        self.ends.append(made := Listener(self.channel))
        return made

    def forwarder(self) -> Forwarder:
        """Start a forwarder to the base robot of the facility."""
        self.ends.append(made := Forwarder(int(self.endpoint.rpartition(":")[2])))
        return made

    def wait_for_instants(self, out: str = "hil", timeout: float = 30.0) -> None:
        """Wait until the loop has executed an instant. Before it, there is no flight recording."""
        directory, end = (self.folder / out).absolute(), time.monotonic() + timeout
        while time.monotonic() < end:
            for path in rings().glob("*.ring"):
                # A ring may be incomplete or removed meanwhile.
                with suppress(OSError, RecordError), closing(RingReader(path)) as ring:
                    if Path(ring.head.directory) == directory and ring.written > 0:
                        return
            time.sleep(0.01)
        raise AssertionError("the loop has not started")

    def summary(self, out: str = "hil") -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.folder / out / "summary.json").read_text())
        return found

    def record(self, out: str = "hil") -> pandas.DataFrame:
        return pandas.read_parquet(self.folder / out / "record.parquet")

    def facility_report(self, process: Process) -> dict[str, Any]:
        """End the facility with SIGINT and return its report."""
        process.send(signal.SIGINT)
        assert process.finish() == 0, process.text
        found: dict[str, Any] = json.loads((self.folder / "facility" / "facility.json").read_text())
        return found


@contextmanager
def rig(folder: Path, scenario: str = "facility") -> Iterator[Rig]:
    made = Rig(folder, scenario)
    try:
        yield made
    finally:
        for process in made.started:
            process.end()
        for end in made.ends:
            end.end()


def activations(report: dict[str, Any], device: str) -> int:
    return sum("-> active" in event for event in events(report, device))


def events(report: dict[str, Any], device: str) -> list[str]:
    return [event for session in report["sessions"] for _, event in session["events"][device]]
