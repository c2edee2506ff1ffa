"""The loop's side of a recording: one row of numbers for every instant, and what happens before the first and after the last."""

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
from freeflyer_adapters.recording.header import CanChannel, RecordingHeader
from freeflyer_adapters.recording.parts import parts, save_rest
from freeflyer_adapters.recording.recorder import GOODBYE, READY, Written
from freeflyer_adapters.recording.recording_file import FLIGHT, save_flight
from freeflyer_adapters.recording.rescue import set_aside
from freeflyer_adapters.recording.ring import RingReader, RingWriter
from freeflyer_adapters.recording.wall_clock import WallClock

COUNTERS_EVERY = 10
"""Instants between two looks at the devices' counters; their states are looked at in every one."""
PATIENCE = 30.0
"""How long the loop waits for its recorder before the begin and after the end [s]; nothing moves then."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """How a run is to be recorded. `everything`: the whole run and the CAN channels, not only its last seconds."""

    directory: Path
    everything: bool = True
    can: bool = True
    """Not, where the channels are in this process's memory only."""
    can_format: str = "blf"


def can_channels(devices: Sequence[Device]) -> list[CanChannel]:
    """Of the devices whose options name a CAN interface and a channel; one that several devices share is there once."""
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


class Tap:
    """Opened before the loop begins; `write` in every instant; `close` whatever has happened."""

    def __init__(
        self,
        wanted: Recording,
        scenario: Scenario,
        master: Master,
        values: Values,
        devices: Sequence[Device],
    ) -> None:
        """RecordError if there is no memory for the ring. A recorder that does not start is a sentence in the result."""
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
        self._clock = WallClock.start()
        head = RecordingHeader(
            scenario=scenario.name,
            title=scenario.title,
            tick=master.schedule.tick,
            started=self._clock.started,
            clock_offset=self._clock.offset if self._clock.is_the_machines else None,
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
        self._line = np.zeros(head.width)
        width = self._now.size
        self._signals, self._states = self._line[:width], self._line[width : width + len(states)]
        self._counts = self._line[width + len(states) :]
        self._directory = wanted.directory.absolute()
        self._missing: list[str] = []
        if wanted.everything:
            set_aside(wanted.directory, head.can, wanted.can_format)
        self._ring = RingWriter(head)
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
        """Its imports are over before anything moves."""
        assert self._recorder is not None
        assert self._recorder.stdout is not None
        ready, _, _ = select.select([self._recorder.stdout], [], [], PATIENCE)
        if not ready or self._recorder.stdout.readline().strip() != READY.encode():
            self._missing.append("the recorder has not started")

    @property
    def recorder(self) -> int | None:
        """Its process."""
        return None if self._recorder is None else self._recorder.pid

    def write(self, k: int) -> None:
        """Everything as it is now, as instant k."""
        self._signals[:] = self._now
        states = self._states
        for i, device in enumerate(self._devices):
            states[i] = device.state.now
        if k % COUNTERS_EVERY == 0:
            self._count()
        self._ring.write(k, self._line)

    def _count(self) -> None:
        place, counts = 0, self._counts
        for device, names in self._counters:
            report = device.report()
            for name in names:
                counts[place] = report.get(name, 0.0)
                place += 1

    def close(self, reason: str, k: int | None = None) -> Mapping[str, Any]:
        """What was written, as the result tells it. `k`: the instant of the end, which the loop has not told in its turn."""
        with contextlib.suppress(Exception):  # a counter of a broken driver must not cost the row
            self._count()
        if k is not None and k > self._ring.last_instant >= 0:
            self._signals[:] = self._now
            for i, device in enumerate(self._devices):
                self._states[i] = device.state.now
            self._ring.write(k, self._line)
        self._ring.say_reason(reason)
        # The recorder names steps with their moments; the difference of start and end is for one that has died, or has other clocks.
        written = self._written(self._clock.whole_step())
        self._ring.close()
        return {**asdict(written), "missing": [*self._missing, *written.missing]}

    def _add_rest(self, reader: RingReader, written: Written) -> None:
        try:
            save_rest(reader, "the loop, without its recorder", written.clock_steps)
            if reader.head.records and self._directory.is_dir():
                written.recording = [str(path) for path in parts(self._directory)]
        except (OSError, CosimError) as error:
            written.missing.append(
                f"what the ring had of the recording's end is not written: {error}"
            )

    def _written(self, clock_steps: list[str]) -> Written:
        """By the recorder; what it has not done is done here, and `clock_steps` stand for what it has not named."""
        said = b""
        why = "the recorder did not live to the end; `freeflyer recover` makes its files whole"
        if self._recorder is not None:
            try:
                said, _ = self._recorder.communicate(GOODBYE, timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                why = f"the recorder (process {self._recorder.pid}) is held up since {PATIENCE:g} s; it ends by itself once it goes on"
            except (OSError, ValueError):
                pass
        try:
            written = Written(**json.loads(said))
        except (ValueError, TypeError):
            written = Written(missing=[why])
        written.clock_steps = written.clock_steps or clock_steps
        if written.flight is not None or self._ring.last_instant < 0:
            return written
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
