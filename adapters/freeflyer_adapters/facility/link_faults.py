"""What faults do to the packets of one device's link, whatever the transport: counted in the facility's cycles, without a clock."""

from __future__ import annotations

import random
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, Literal, Protocol, TypeVar

from freeflyer_adapters.facility.faults import KINDS, Fault

P = TypeVar("P")
Way = Literal["to_controller", "to_device"]


class Tamper(Protocol[P]):
    """How a transport's packets are changed. Each call gives a new packet, or None if these packets have nothing of the kind."""

    def changed(
        self, fault: Fault, way: Way, packet: P, memory: dict[str, Any], lot: random.Random
    ) -> P | None:
        """`memory` is the fault's own, and empty when it begins."""


TAMPERING = (
    "flipped_bits",
    "wrong_data_id",
    "stale_stamp",
    "frozen_counter",
    "not_a_number",
    "out_of_range",
    "clock_jump",
)


@dataclass
class _Fault:
    """A fault with its own random numbers, so that one more fault does not change what the others do."""

    fault: Fault
    begin: int | None
    """[cycles since activation]; None: always."""
    end: float
    lot: random.Random
    memory: dict[str, Any]
    acts: bool = False

    def move(self, since_active: int | None) -> None:
        acted = self.acts
        if self.begin is None:
            self.acts = True
        else:
            self.acts = since_active is not None and self.begin <= since_active < self.end
        if self.acts and not acted:
            self.memory.clear()


class LinkFaults(Generic[P]):
    """The faults of one device on both ways of its link.

    `begin_cycle` first; then every packet goes through `pass_on`, and what is `due` is what arrives now. `tampered` keeps (way, as
    it was, as it became) for tests that compare, if `keeps` is set.
    """

    def __init__(
        self, faults: Sequence[Fault], period: float, seed: int, tamper: Tamper[P]
    ) -> None:
        self._all = []
        for i, fault in enumerate(faults):
            begin = None if fault.begin_s is None else round(fault.begin_s / period)
            # One that is shorter than a cycle acts for one.
            end = (begin or 0) + max(1.0, fault.duration_s / period)
            self._all.append(
                _Fault(fault, begin, end, random.Random(f"{seed}/{i}/{fault.kind}"), {})
            )
        # What a sender gets wrong comes before what happens on the way: nobody protects what a cable has changed.
        self._all.sort(key=lambda one: one.fault.kind == "flipped_bits")
        self.period, self._tamper = period, tamper
        self._queues: dict[Way, deque[tuple[int, P]]] = {
            "to_controller": deque(),
            "to_device": deque(),
        }
        self._overtaken: dict[Way, list[P]] = {"to_controller": [], "to_device": []}
        self._cycle = 0
        self.acted: Counter[str] = Counter()
        """How many packets each kind has met."""
        self.keeps = False
        self.tampered: list[tuple[Way, P, P]] = []

    def begin_cycle(self, since_active: int | None) -> None:
        """`since_active`: cycles since the device became active for the first time in this session."""
        self._cycle += 1
        for one in self._all:
            one.move(since_active)

    def acts(self, kind: str) -> bool:
        """Whether a fault of the whole device acts now."""
        return any(one.acts and one.fault.kind == kind for one in self._all)

    def reset(self) -> None:
        """A new session: nothing is under way."""
        for way in self._queues:
            self._queues[way].clear()
            self._overtaken[way].clear()
        for one in self._all:
            one.acts = False

    def pass_on(self, way: Way, packet: P) -> None:
        """A packet is sent into the link."""
        queue, copies, delay, held_back = self._queues[way], 1, 0, False
        for one in self._all:
            fault = one.fault
            if not one.acts or fault.direction not in (way, "both"):
                continue
            if "probability" in KINDS[fault.kind].takes and one.lot.random() >= fault.probability:
                continue
            if fault.kind in ("loss", "cut"):
                self.acted[fault.kind] += 1
                return
            if fault.kind in TAMPERING:
                changed = self._tamper.changed(fault, way, packet, one.memory, one.lot)
                if changed is None:
                    continue
                if self.keeps:
                    self.tampered.append((way, packet, changed))
                packet = changed
            elif fault.kind == "duplication":
                copies += 1
            elif fault.kind == "delay":
                delay += self._cycles(fault.delay_s)
            elif fault.kind == "jitter":
                delay += self._cycles(one.lot.uniform(0.0, fault.delay_s))
            elif fault.kind == "reordering":
                held_back = True
            else:
                continue
            self.acted[fault.kind] += 1
        # In order: nobody is overtaken on a queue.
        due = self._cycle + delay
        if queue:
            due = max(due, queue[-1][0])
        overtaken = self._overtaken[way]
        if held_back and not overtaken:
            overtaken += [packet] * copies
            return
        queue.extend((due, packet) for _ in range(copies))
        queue.extend((due, late) for late in overtaken)
        overtaken.clear()

    def due(self, way: Way) -> P | None:
        """The next packet that arrives now; it is handed out once."""
        queue = self._queues[way]
        if queue and queue[0][0] <= self._cycle:
            return queue.popleft()[1]
        return None

    def _cycles(self, time: float) -> int:
        return -int(-time // self.period)
