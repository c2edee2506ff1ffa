"""Recording client of the loop: starts the recorder and writes one row per instant.

The recorder is a separate process. An instant is a point in time at which the loop computes. The
row of an instant contains the values of all signals, states and counters. The client writes the
rows to a ring (`freeflyer_adapters.recording.ring`). A ring is a ring buffer in shared memory,
which the recorder reads.
"""

from __future__ import annotations

import contextlib
import json
import select
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from freeflyer.foundation.errors import CosimError
from freeflyer.foundation.signal_name import split
from freeflyer.master.master import Master
from freeflyer.master.record import Signal
from freeflyer.scenario import metrics
from freeflyer.scenario.experiment import provenance
from freeflyer.scenario.parameters import Values
from freeflyer.scenario.scenario import Scenario
from freeflyer_adapters.device.device import STATE, Device
from freeflyer_adapters.recording.mcap_file import FLIGHT, save_flight
from freeflyer_adapters.recording.parts import parts, save_rest
from freeflyer_adapters.recording.recorder import GOODBYE, READY, Written
from freeflyer_adapters.recording.ring import RingReader, RingWriter
from freeflyer_adapters.recording.ring_header import CanChannel, RecordingHeader
from freeflyer_adapters.recording.wall_clock import WallClock

COUNTERS_EVERY = 10
"""Number of instants between two readings of the counters. States are read at every instant."""
TIMEOUT = 30.0
"""Longest wait for the start and for the end of the recorder [s].

No device is active during these waits."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Options of a recording."""

    directory: Path
    everything: bool = True
    """True: record the whole run and the CAN channels. False: record only the last seconds."""
    can: bool = True
    """Record the CAN channels. False if the channels exist only in the memory of this process."""
    can_format: str = "blf"


def can_channels(devices: Sequence[Device]) -> list[CanChannel]:
    """Return the CAN channels that the devices use. A shared channel is listed only once."""
    found: dict[tuple[str, str], CanChannel] = {}
    for device in devices:
        options = getattr(device, "options", None)
        interface, channel = getattr(options, "interface", None), getattr(options, "channel", None)
        if isinstance(interface, str) and isinstance(channel, str):
            is_fd = bool(getattr(getattr(device, "frames", None), "is_fd", False))
            bus = dict(getattr(options, "bus", {}))
            found.setdefault(
                (interface, channel),
                CanChannel(
                    name=device.name, interface=interface, channel=channel, is_fd=is_fd, bus=bus
                ),
            )
    return list(found.values())


class RecordingClient:
    """Client of one recorder process. A ring in shared memory connects client and recorder.

    Create the client before the loop starts. Call `write` at every instant. Always call `close`.
    """

    def __init__(
        self,
        wanted: Recording,
        scenario: Scenario,
        master: Master,
        values: Values,
        devices: Sequence[Device],
    ) -> None:
        """Start the recorder. If the start fails, the result of `close` contains a message.

        `wanted`: options of the recording. `values`: parameter values of the components.

        Raises RecordError if there is not enough memory for the ring.
        """
        # A row contains all signals of the master, then the states, then the counters.
        places = master.slaves.places
        ports = {name: component.ports for name, component in master.graph.components.items()}
        signals = []
        for name, place in places.items():
            component, variable = split(name)
            units = ports[component][variable].units
            signals.append(
                Signal(name=name, first=place.start, size=place.stop - place.start, units=units)
            )
        signals.sort(key=lambda signal: signal.first)
        self._now, self._devices = master.slaves.now, devices
        states = [f"{device.name}{STATE}" for device in devices]
        self._counters = [(device, tuple(device.report())) for device in devices]
        counts = [
            f"{device.name}: {name.replace('_', ' ')}"
            for device, names in self._counters
            for name in names
        ]
        # The header describes the row and the run.
        self._clock = WallClock.start()
        header = RecordingHeader(
            scenario=scenario.name,
            title=scenario.title,
            tick=master.schedule.tick,
            started=self._clock.started,
            clock_offset=self._clock.offset if self._clock.is_system_clock else None,
            directory=str(wanted.directory.absolute()),
            signals=signals,
            chosen=frozenset(master.record.signals),
            loop=[*states, *counts],
            origin=json.loads(provenance(scenario, master, values).to_json()),
            versions=metrics.versions(),
            records=wanted.everything,
            can=can_channels(devices) if wanted.everything and wanted.can else [],
            can_format=wanted.can_format,
        )
        # Views of one row. `write` fills this row in place.
        self._line = np.zeros(header.width)
        width = self._now.size
        self._signals, self._states = self._line[:width], self._line[width : width + len(states)]
        self._counts = self._line[width + len(states) :]
        # Create the ring before the recorder, because the recorder opens the ring at its start.
        self._directory = wanted.directory.absolute()
        self._missing: list[str] = []
        self._ring = RingWriter(header)
        self._recorder: subprocess.Popen[bytes] | None = None
        try:
            self._recorder = subprocess.Popen(
                [
                    sys.executable,
                    "-P",
                    "-m",
                    "freeflyer_adapters.recording.recorder",
                    str(self._ring.path),
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            self._await_start()
        except OSError as error:
            self._missing.append(f"the recorder has not started: {error.strerror}")

    def _await_start(self) -> None:
        """Wait until the recorder has finished its imports."""
        assert self._recorder is not None
        assert self._recorder.stdout is not None
        ready, _, _ = select.select([self._recorder.stdout], [], [], TIMEOUT)
        if not ready or self._recorder.stdout.readline().strip() != READY.encode():
            self._missing.append("the recorder has not started")

    @property
    def recorder(self) -> int | None:
        """Process ID of the recorder, or None if the recorder did not start."""
        return None if self._recorder is None else self._recorder.pid

    def write(self, k: int) -> None:
        """Write the present signals, states and counters as the row of instant `k`."""
        self._signals[:] = self._now
        states = self._states
        for i, device in enumerate(self._devices):
            states[i] = device.state.now
        if k % COUNTERS_EVERY == 0:
            self._update_counters()
        self._ring.write(k, self._line)

    def _update_counters(self) -> None:
        place, counts = 0, self._counts
        for device, names in self._counters:
            report = device.report()
            for name in names:
                counts[place] = report.get(name, 0.0)
                place += 1

    def close(self, reason: str, k: int | None = None) -> Mapping[str, Any]:
        """End the recording. Return the written files and the missing data, for the result.

        `reason` is a text that explains why the loop has stopped. `k` is the last instant. If the
        ring does not yet contain the row of instant `k`, this row is written now.
        """
        # A driver that has failed must not prevent the writing of the last row.
        with contextlib.suppress(Exception):
            self._update_counters()
        if k is not None and k > self._ring.last_instant >= 0:
            self._signals[:] = self._now
            for i, device in enumerate(self._devices):
                self._states[i] = device.state.now
            self._ring.write(k, self._line)
        self._ring.set_reason(reason)
        # The recorder reports the size and the time of each step of the wall clock. If the recorder
        # reports no step, the sum of all steps is reported instead.
        written = self._written(self._clock.total_step())
        self._ring.close()
        return {**asdict(written), "missing": [*self._missing, *written.missing]}

    def _add_rest(self, reader: RingReader, written: Written) -> None:
        """Write the rows that are in the ring, but not yet in the recording."""
        try:
            save_rest(reader, "the loop, without its recorder", written.clock_steps)
            if reader.head.records and self._directory.is_dir():
                written.recording = [str(path) for path in parts(self._directory)]
        except (OSError, CosimError) as error:
            written.missing.append(
                f"the end of the recording could not be written from the ring: {error}"
            )

    def _written(self, clock_steps: list[str]) -> Written:
        """Return the result of the recorder. Write the files that the recorder has not written.

        `clock_steps` is used if the recorder reports no clock steps.
        """
        # After GOODBYE, the recorder writes its result in JSON and ends.
        answer = b""
        why = "the recorder ended early; `freeflyer recover` repairs its files"
        if self._recorder is not None:
            try:
                answer, _ = self._recorder.communicate(GOODBYE, timeout=TIMEOUT)
            except subprocess.TimeoutExpired:
                why = f"the recorder (process {self._recorder.pid}) has not responded for {TIMEOUT:g} s; if the recorder is suspended, it ends by itself after it is resumed"
            except (OSError, ValueError):
                pass
        try:
            written = Written(**json.loads(answer))
        except (ValueError, TypeError):
            written = Written(missing=[why])
        written.clock_steps = written.clock_steps or clock_steps
        if written.flight is not None or self._ring.last_instant < 0:
            return written
        # The recorder has not saved the flight recording. Save it here from the ring.
        try:
            with closing(RingReader(self._ring.path)) as reader:
                flight = save_flight(
                    reader, "the loop, without its recorder", FLIGHT, written.clock_steps
                )
                written.flight = None if flight is None else str(flight)
                if self._recorder is None or self._recorder.poll() is not None:
                    self._add_rest(reader, written)
        except CosimError as error:
            written.missing.append(
                f"the flight recording is missing: {error}; `freeflyer recover {self._ring.path}` saves it"
            )
            return written
        if self._recorder is None or self._recorder.poll() is not None:
            self._ring.path.unlink(missing_ok=True)
        return written
