"""Recording header: a description of the recording, stored as JSON at the start of a ring.

A ring is a ring buffer in shared memory (`freeflyer_adapters.recording.ring`). It contains one row
of numbers for every instant, that is, for every point in time at which the loop computes. The
header describes the columns of the rows. Therefore a ring can be read even after all processes of
the run have ended.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from freeflyer.foundation.errors import RecordError
from freeflyer.master.record import Signal

WIDEST = 100_000
"""Maximum number of columns of a row. A header that describes more columns is rejected."""


@dataclass(frozen=True, kw_only=True)
class CanChannel:
    """A CAN channel whose frames are logged.

    `name`: name for the log file. `interface`, `channel`: names in python-can. `is_fd`: the channel
    uses CAN FD. `bus`: further options of python-can.
    """

    name: str
    interface: str
    channel: str
    is_fd: bool
    bus: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RecordingHeader:
    """The header of a recording.

    `tick`: time between two instants [ns]. A row contains the signals, then the states of the
    devices, then the counters. `loop`: names of the columns for states and counters.
    `can`, `can_format`: logged CAN channels, and file format of the logs.
    """

    scenario: str
    title: str
    tick: int
    started: int
    """Start of the run [ns since the epoch]."""
    directory: str
    """Directory of the run's results."""
    signals: Sequence[Signal]
    """The outputs of all components, in the order of the columns."""
    chosen: frozenset[str]
    """Names of the signals that the scenario table `[record]` selects."""
    loop: Sequence[str]
    origin: Mapping[str, Any]
    """Provenance of the run, see freeflyer.master.provenance.Provenance."""
    versions: Mapping[str, str]
    records: bool = True
    """True: the whole run is recorded. False: only the last seconds are recorded."""
    can: Sequence[CanChannel] = ()
    can_format: str = "blf"
    clock_offset: int | None = None
    """Wall clock minus monotonic clock at the start [ns].

    None if the recorder cannot read the clocks of the loop (virtual time). Also None in rings of
    earlier versions."""

    @property
    def width(self) -> int:
        """Number of columns of a row."""
        return sum(signal.size for signal in self.signals) + len(self.loop)

    def to_json(self) -> bytes:
        raw = {**asdict(self), "chosen": sorted(self.chosen)}
        return json.dumps(raw).encode()

    @classmethod
    def from_json(cls, text: bytes) -> RecordingHeader:
        """Parse the JSON of `to_json`. Raises RecordError for any other text."""
        try:
            # The first signal starts at column 0. Each further signal starts where the previous
            # signal ends.
            raw = json.loads(text)
            signals = [
                Signal(**{**signal, "units": tuple(signal["units"])}) for signal in raw["signals"]
            ]
            first = 0
            for signal in signals:
                if (
                    type(signal.size) is not int
                    or signal.first != first
                    or len(signal.units) != signal.size
                ):
                    raise ValueError(f"size, place or units of signal {signal.name} are invalid")
                first += signal.size
            # The dataclass rejects unknown and missing keys, but does not check types.
            head = cls(**{
                **raw,
                "signals": signals,
                "chosen": frozenset(raw["chosen"]),
                "can": [CanChannel(**channel) for channel in raw["can"]],
            })  # fmt: skip
            texts = (
                head.scenario,
                head.title,
                head.directory,
                head.can_format,
                *head.loop,
                *(s.name for s in signals),
            )
            if not all(isinstance(text, str) for text in texts) or not isinstance(
                head.origin, dict
            ):
                raise ValueError("a value that must be a text has another type")
            if (
                type(head.tick) is not int
                or head.tick <= 0
                or type(head.started) is not int
                or not 0 < head.width <= WIDEST
            ):
                raise ValueError(
                    "a value that must be a number has another type or is out of range"
                )
            if head.clock_offset is not None and type(head.clock_offset) is not int:
                raise ValueError(
                    "a value that must be a number has another type or is out of range"
                )
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise RecordError(f"the header of a ring is invalid: {error}") from error
        return head
