"""What a recording is about, as JSON at the head of its ring, so that the ring can be read when everybody who knew has died."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from freeflyer.foundation.errors import RecordError
from freeflyer.master.record import Signal

WIDEST = 100_000
"""Columns of a row; a ring's head that claims more is no head of ours."""


@dataclass(frozen=True, kw_only=True)
class CanChannel:
    """A CAN channel that is logged, as python-can names it."""

    name: str
    interface: str
    channel: str
    is_fd: bool
    bus: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RecordingHeader:
    """`tick` [ns]: from one instant to the next. `loop`: the loop's columns after the signals: states, then counters."""

    scenario: str
    title: str
    tick: int
    started: int
    """When the run began [ns since the epoch]."""
    directory: str
    """Where the run's results go."""
    signals: Sequence[Signal]
    """Every output of the system, in the order of a row."""
    chosen: frozenset[str]
    """Names of the signals that `[record]` chooses."""
    loop: Sequence[str]
    origin: Mapping[str, Any]
    """See freeflyer.master.provenance.Provenance."""
    versions: Mapping[str, str]
    records: bool = True
    """Whether the whole run is recorded, or its last seconds only."""
    can: Sequence[CanChannel] = ()
    can_format: str = "blf"
    clock_offset: int | None = None
    """Wall clock minus monotonic clock at the start [ns]; None where the recorder has other clocks, and in rings of earlier versions."""

    @property
    def width(self) -> int:
        return sum(signal.size for signal in self.signals) + len(self.loop)

    def to_json(self) -> bytes:
        raw = {**asdict(self), "chosen": sorted(self.chosen)}
        return json.dumps(raw).encode()

    @classmethod
    def from_json(cls, text: bytes) -> RecordingHeader:
        """RecordError for anything that `to_json` has not written."""
        try:
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
                    raise ValueError(f"signal {signal.name} does not fit")
                first += signal.size
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
                raise ValueError("a text is none")
            if (
                type(head.tick) is not int
                or head.tick <= 0
                or type(head.started) is not int
                or not 0 < head.width <= WIDEST
            ):
                raise ValueError("its numbers do not fit")
            if head.clock_offset is not None and type(head.clock_offset) is not int:
                raise ValueError("its numbers do not fit")
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise RecordError(f"the head of a ring does not say what is in it: {error}") from error
        return head
