"""Recorder: a separate process that reads the ring of a loop and writes the recording.

A ring is a ring buffer in shared memory (`freeflyer_adapters.recording.ring`). The loop writes one
row to the ring at every instant, and a pipe connects the loop to the recorder. When the loop ends
or crashes, this pipe is closed. The recorder then writes the remaining rows, and the index and the
summary of the MCAP file. It also writes the flight recording, which contains the last seconds
before the stop. Then the recorder removes the ring, and reports the written files in one line of
JSON. Errors of the recorder do not affect the loop.
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

from freeflyer.foundation.errors import CosimError, one_line
from freeflyer_adapters.foundation import pacing
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.recording.can_log import CanLog
from freeflyer_adapters.recording.mcap_file import FLIGHT, save_flight, stop_of
from freeflyer_adapters.recording.parts import PartedRecording
from freeflyer_adapters.recording.ring import RingReader
from freeflyer_adapters.recording.wall_clock import WallClock

PERIOD = 0.05
"""Time between two reads of the ring [s]."""
NICE = -10
"""Change of the recorder's nice value (see `follow`), if the system permits it."""
BATCH = 1000
"""Maximum number of rows per read."""
READY = "ready"
GOODBYE = b"."
"""Byte that the loop sends at its regular end."""


@dataclass(kw_only=True)
class Written:
    """The result of a recorder.

    `recording`: paths of the parts. `can`: paths of the CAN logs. `flight`: path of the flight
    recording. `rows_lost`: number of rows that were overwritten before they were read. `missing`:
    messages about data that could not be written. `clock_steps`: messages about steps of the wall
    clock.
    """

    recording: list[str] = field(default_factory=list)
    can: list[str] = field(default_factory=list)
    flight: str | None = None
    rows: int = 0
    rows_lost: int = 0
    missing: list[str] = field(default_factory=list)
    clock_steps: list[str] = field(default_factory=list)


class Recorder:
    """The recorder of a loop. Call `step` while the loop runs, then `finish`.

    An error of the disk or of a bus is not raised. It is passed to `complain` as a message.
    """

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
        """Report an error of the output `subject`, and add it to the result. Do not raise it."""
        try:
            yield
        except (OSError, CosimError, DeviceError) as error:
            text = getattr(error, "strerror", None) or one_line(error)
            self.written.missing.append(f"{subject} is incomplete: {text}")
            self._complain(f"{subject} has stopped: {text}; the loop continues")

    def step(self) -> None:
        """Write all frames and rows since the last call."""
        # Take the frames first, because the buffers of the frames are smaller than the ring.
        self._take_frames()
        self._check_clock()
        behind = True
        while behind:
            rows = self.ring.take(BATCH)
            # After an incomplete batch, leave the `while` loop. Otherwise new rows might keep it
            # running.
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

    def _check_clock(self) -> None:
        if self._clock is None:
            return
        step = self._clock.check()
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
            log.close_bus()

    def _name_parts(self) -> None:
        self.written.recording = [str(path) for path in self._parts]

    def finish(self) -> Written:
        """Finish all files after the end of the loop."""
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
    """Record until the loop sends `GOODBYE` or closes the pipe.

    `pipe` is the file descriptor of the pipe from the loop. `loop` is the process ID of the loop.
    """
    waiting = select.poll()
    waiting.register(pipe, select.POLLIN | select.POLLHUP)
    has_priority = False
    while not waiting.poll(PERIOD * 1e3):
        recorder.step()
        if recorder.written.rows and not has_priority:
            has_priority = True
            # On a busy machine, a recorder with normal priority loses CAN frames. Therefore raise
            # its priority, but only if the loop has SCHED_FIFO. Such a loop precedes every process
            # without SCHED_FIFO.
            with contextlib.suppress(OSError, AttributeError):
                if os.sched_getscheduler(loop) == os.SCHED_FIFO:
                    os.nice(NICE)


def main(path: str) -> int:
    """Run the recorder for the ring at `path`.

    Signals from the terminal are ignored, because the loop handles them and then closes the pipe.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    if hasattr(signal, "SIGXFSZ"):
        # If a file exceeds the size limit, writing now raises OSError. This error is reported.
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
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
        # If the flight recording could not be written, keep the ring: only the ring has these rows.
        ring.remove()
    with contextlib.suppress(OSError):
        print(json.dumps(asdict(written)), flush=True)
    with contextlib.suppress(OSError):
        sys.stdout.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
