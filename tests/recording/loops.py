"""Loops in separate processes whose recorders tests can kill, and a small synthetic run."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np

from freeflyer.foundation.errors import RecordError
from freeflyer.master.record import Signal
from freeflyer_adapters.recording.mcap_file import RecordingFile
from freeflyer_adapters.recording.ring import RingReader, Rows
from freeflyer_adapters.recording.ring_header import RecordingHeader

TICK = 1_000_000
START = 1_800_000_000_000_000_000
PARTS = {
    "arm.joint_position": ("rad",) * 2,
    "arm.joint_torque": ("N.m",) * 2,
    "base_robot.base_position": ("m",) * 3,
    "base_robot.base_orientation": ("1",) * 4,
    "base_robot.base_velocity": ("m/s",) * 3 + ("rad/s",) * 3,
    "end_effector.position": ("m",) * 3,
    "end_effector.orientation": ("1",) * 4,
    "controller.end_effector_wrench": ("N",) * 3 + ("N.m",) * 3,
    "controller.Odd name (2)": (None,),
}


def head(directory: Path) -> RecordingHeader:
    signals, first = [], 0
    for name, units in PARTS.items():
        signals.append(Signal(name=name, first=first, size=len(units), units=units))
        first += len(units)
    return RecordingHeader(
        scenario="made", title="Made of numbers", tick=TICK, started=START, directory=str(directory), signals=signals,
        chosen=frozenset(PARTS), loop=["arm: state", "arm: cycles lost"], origin={"parameters": {"arm": {"mass": 2.0}}},
        versions={"python": "3"},
    )  # fmt: skip


def rows(count: int, width: int, seed: int = 0) -> Rows:
    """Return random rows; the orientations are unit quaternions."""
    generator = np.random.default_rng(seed)
    values = generator.normal(size=(count, width))
    for name, signal in {s.name: s for s in head(Path("/")).signals}.items():
        if "orientation" in name:
            part = values[:, signal.first : signal.first + 4]
            part /= np.linalg.norm(part, axis=1, keepdims=True)
    k = np.arange(count)
    return Rows(np.stack([START + k * TICK, 5_000 + k * TICK, k], axis=1), values)


def recording(
    count: int, chunk_seconds: float = 0.02, *, finished: bool = True, seed: int = 0
) -> bytes:
    """Return the bytes of a recording of `count` rows."""
    made, stream = head(Path("/")), BytesIO()
    file = RecordingFile(stream, made, made.signals, chunk_seconds)
    file.add(rows(count, made.width, seed))
    if finished:
        file.finish({"reason": "it was enough"})
    return stream.getvalue()


def alone(runtime: Path) -> dict[str, str]:
    """Return environment variables with a separate directory of rings."""
    return {**os.environ, "XDG_RUNTIME_DIR": str(runtime)}


class Loop:
    """A process `freeflyer hil facility --simulated` with its recorder."""

    def __init__(self, out: Path, runtime: Path, *options: str, stop: float = 60.0) -> None:
        command = [
            sys.executable,
            "-m",
            "freeflyer.cli.main",
            "hil",
            "facility",
            "--simulated",
            "--no-view",
            "--out",
            str(out),
        ]
        self.out, self.runtime = out, runtime
        self.process = subprocess.Popen(
            [*command, "--set", f"stop_s={stop}", *options],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=alone(runtime), start_new_session=True,
        )  # fmt: skip
        self.ring: RingReader | None = None

    def wait_for_rows(self, count: int, timeout: float = 60.0) -> RingReader:
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            for path in self.runtime.glob("freeflyer-rings-*/*.ring"):
                if self.ring is None:
                    try:
                        self.ring = RingReader(path)
                    except RecordError:
                        continue  # the ring is not yet complete
            if self.ring is not None and self.ring.written >= count:
                return self.ring
            assert self.process.poll() is None, self.finish()
            time.sleep(0.005)
        raise AssertionError("the loop has not started")

    @property
    def recorder(self) -> int:
        children = (
            Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        )
        found = [
            int(pid)
            for pid in children
            if b"freeflyer_adapters.recording.recorder" in Path(f"/proc/{pid}/cmdline").read_bytes()
        ]
        assert len(found) == 1
        return found[0]

    def release_ring(self) -> None:
        """Release the lock of the ring; it is then left behind if its loop has ended."""
        if self.ring is not None:
            self.ring.close()

    def finish(self, timeout: float = 60.0) -> str:
        output, _ = self.process.communicate(timeout=timeout)
        assert "Traceback" not in output, output
        return output

    def end(self) -> None:
        self.release_ring()
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()


@contextmanager
def loop(out: Path, runtime: Path, *options: str, stop: float = 60.0) -> Iterator[Loop]:
    made = Loop(out, runtime, *options, stop=stop)
    try:
        yield made
    finally:
        made.end()


def wait_until_gone(pid: int, timeout: float = 60.0) -> None:
    """Wait for the end of a process that is not a child of this process."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return
        except FileNotFoundError:
            return
        time.sleep(0.01)
    raise AssertionError(f"process {pid} has not ended")
