"""The recorder: a process of its own that follows a loop's ring and writes what is in it.

It outlives the loop: when the loop has said why it ended, or has died (either closes the pipe between them), it writes what is left,
index, summary and the flight recording, says in one line of JSON what it has written, and removes the ring. Nothing that goes wrong
here reaches the loop.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from freeflyer.foundation.errors import CosimError
from freeflyer_adapters.device.device import DeviceError
from freeflyer_adapters.foundation import pacing
from freeflyer_adapters.recording.can_log import CanLog
from freeflyer_adapters.recording.parts import PartedRecording
from freeflyer_adapters.recording.recording_file import FLIGHT, save_flight, stop_of
from freeflyer_adapters.recording.ring import RingReader
from freeflyer_adapters.recording.wall_clock import WallClock

PERIOD = 0.05
"""Between two looks at the ring [s]."""
NICE = -10
"""Among ordinary processes, where permitted."""
BATCH = 1000
"""Rows at a time."""
READY = "ready"
GOODBYE = b"."
"""What the loop sends when it ends in order."""


@dataclass(kw_only=True)
class Written:
    """What a recorder leaves behind. `missing`: sentences about what could not be written. `recording`: its parts. `clock_steps`:
    sentences about steps of this machine's wall clock.
    """

    recording: list[str] = field(default_factory=list)
    can: list[str] = field(default_factory=list)
    flight: str | None = None
    rows: int = 0
    rows_lost: int = 0
    missing: list[str] = field(default_factory=list)
    clock_steps: list[str] = field(default_factory=list)


class Recorder:
    """`step` as long as the loop lives, then `finish`. Never raises for what the disk or a bus does."""

    def __init__(self, ring: RingReader, complain: Callable[[str], None]) -> None:
        self.ring, self._complain = ring, complain
        self.written = Written()
        self._directory = Path(ring.head.directory)
        offset = ring.head.clock_offset
        self._clock = None if offset is None else WallClock(offset, ring.head.started)
        self._file: PartedRecording | None = None
        self._logs: list[CanLog] = []
        if not ring.head.records:
            return
        with self._watched("the recording"):
            self._file = PartedRecording(ring.head)
            self._parts = self._file.paths
            self._name_parts()
        several = len(ring.head.can) > 1
        for channel in ring.head.can:
            name = f"can_{channel.name}" if several else "can"
            with self._watched(f"the log of CAN channel {channel.channel}"):
                self._logs.append(
                    CanLog(channel, self._directory / f"{name}.{ring.head.can_format}", self._clock)
                )

    @contextlib.contextmanager
    def _watched(self, subject: str) -> Iterator[None]:
        """What goes wrong is said once and noted for the result; the rest goes on."""
        try:
            yield
        except (OSError, CosimError, DeviceError) as error:
            text = getattr(error, "strerror", None) or " ".join(str(error).split())
            self.written.missing.append(f"{subject} is not whole: {text}")
            self._complain(f"{subject} has stopped: {text}; the loop goes on")

    def step(self) -> None:
        """What has come since the last look."""
        self._take_frames()  # first: their buffers are the smaller ones
        self._look_at_the_clock()
        behind = True
        while behind:
            rows = self.ring.take(BATCH)
            # A loop that is followed to the last row is followed for ever.
            behind = len(rows) == BATCH
            if self._file is not None:
                file, self._file = self._file, None
                with self._watched("the recording"):
                    file.add(rows)
                    file.flush()
                    self._file = file
                self._name_parts()
            self.written.rows += len(rows)
        self._take_frames()
        self.written.rows_lost = self.ring.lost

    def _look_at_the_clock(self) -> None:
        if self._clock is None:
            return
        step = self._clock.look()
        if step is not None:
            self.written.clock_steps.append(step)
            self._complain(step)

    def _take_frames(self) -> None:
        logs, self._logs = self._logs, []
        for log in logs:
            with self._watched(f"CAN log {log.path.name}"):
                log.take()
                self._logs.append(log)
                continue
            log.leave()

    def _name_parts(self) -> None:
        self.written.recording = [str(path) for path in self._parts]

    def finish(self) -> Written:
        """The loop has ended."""
        self.step()
        if self._file is not None:
            with self._watched("the recording"):
                self._file.finish(stop_of(self.ring, "the recorder", self.written.clock_steps))
        for log in self._logs:
            with self._watched(f"CAN log {log.path.name}"):
                log.close()
                self.written.can.append(str(log.path))
        with self._watched("the flight recording"):
            flight = save_flight(self.ring, "the recorder", FLIGHT, self.written.clock_steps)
            self.written.flight = None if flight is None else str(flight)
        return self.written


def follow(recorder: Recorder, pipe: int, loop: int) -> None:
    """Until the loop says goodbye, or has gone."""
    waiting = select.poll()
    waiting.register(pipe, select.POLLIN | select.POLLHUP)
    before_ordinary_ones = False
    while not waiting.poll(PERIOD * 1e3):
        recorder.step()
        if recorder.written.rows and not before_ordinary_ones:
            before_ordinary_ones = True
            # Beside a loop in real time, which comes first anyhow: a busy machine must not cost frames, which wait nowhere for long.
            with contextlib.suppress(OSError, AttributeError):
                if os.sched_getscheduler(loop) == os.SCHED_FIFO:
                    os.nice(NICE)


def main(path: str) -> int:
    """Signals of the terminal are the loop's; it tells, by closing the pipe, when it has ended."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    if hasattr(signal, "SIGXFSZ"):
        signal.signal(
            signal.SIGXFSZ, signal.SIG_IGN
        )  # a file that is too long is an error to be told of
    pacing.leave_real_time()

    def complain(sentence: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            print(f"freeflyer: {sentence}", file=sys.stderr, flush=True)

    ring = RingReader(Path(path))
    recorder = Recorder(ring, complain)
    with contextlib.suppress(OSError):
        print(READY, flush=True)
    follow(recorder, sys.stdin.fileno(), os.getppid())
    written = recorder.finish()
    if written.flight is not None or ring.written == 0:
        ring.remove()  # else it is all that there is
    with contextlib.suppress(OSError):
        print(json.dumps(asdict(written)), flush=True)
    with contextlib.suppress(OSError):
        sys.stdout.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
