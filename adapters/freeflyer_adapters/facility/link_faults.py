"""Faults on the packets of a device's link, independent of the transport.

Times are counted in cycles of the facility. The module reads no clock.
"""

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
    """Interface of a class that changes packets of one transport for a fault."""

    def changed(
        self, fault: Fault, way: Way, packet: P, memory: dict[str, Any], generator: random.Random
    ) -> P | None:
        """Return the changed packet, or None if the fault does not apply to this packet.

        `way`: direction of the packet. `generator`: random numbers of this fault. `memory`: data
        that this fault keeps between calls. It is empty when the fault starts.
        """


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
    """A fault with its state.

    Each fault has its own random generator. So the random numbers of a fault do not depend on the
    other faults.
    """

    fault: Fault
    begin: int | None
    """Start [cycles since the first activation]. None: the fault is always active."""
    end: float
    generator: random.Random
    memory: dict[str, Any]
    acts: bool = False

    def move(self, since_active: int | None) -> None:
        """Update `acts` for a new cycle. Clear the memory when the fault starts."""
        acted = self.acts
        if self.begin is None:
            self.acts = True
        else:
            self.acts = since_active is not None and self.begin <= since_active < self.end
        if self.acts and not acted:
            self.memory.clear()


class LinkFaults(Generic[P]):
    """The faults of one device in both directions of its link.

    Call these methods in every cycle, in this order: `begin_cycle`, `pass_on` for every sent
    packet, and `due` until it returns None. `period`: length of a cycle [s]. `seed`: seed of all
    random numbers. `tamper`: changes the content of packets.

    For tests, `keeps` can be set to True. Then `tampered` stores each change of a packet: the
    direction, the original packet and the changed packet.
    """

    def __init__(
        self, faults: Sequence[Fault], period: float, seed: int, tamper: Tamper[P]
    ) -> None:
        self._all = []
        for i, fault in enumerate(faults):
            begin = None if fault.begin_s is None else round(fault.begin_s / period)
            # A fault shorter than a cycle is active for one cycle.
            end = (begin or 0) + max(1.0, fault.duration_s / period)
            self._all.append(
                _Fault(fault, begin, end, random.Random(f"{seed}/{i}/{fault.kind}"), {})
            )
        # Flip bits last. This fault stands for a disturbance on the cable, so it acts after the
        # sender has added the checksum.
        self._all.sort(key=lambda one: one.fault.kind == "flipped_bits")
        self.period, self._tamper = period, tamper
        self._queues: dict[Way, deque[tuple[int, P]]] = {
            "to_controller": deque(),
            "to_device": deque(),
        }
        self._overtaken: dict[Way, list[P]] = {"to_controller": [], "to_device": []}
        self._cycle = 0
        self.acted: Counter[str] = Counter()
        """Number of packets that were affected, by kind of fault."""
        self.keeps = False
        self.tampered: list[tuple[Way, P, P]] = []

    def begin_cycle(self, since_active: int | None) -> None:
        """Start a cycle.

        `since_active`: number of cycles since the first activation in this session. None if the
        device has not yet been activated.
        """
        self._cycle += 1
        for one in self._all:
            one.move(since_active)

    def acts(self, kind: str) -> bool:
        """Return whether a fault of kind `kind` is active now.

        A device calls this method for faults that do not act on single packets, for example `dead`.
        """
        return any(one.acts and one.fault.kind == kind for one in self._all)

    def reset(self) -> None:
        """Discard all queued packets and deactivate all faults, for a new session."""
        for way in self._queues:
            self._queues[way].clear()
            self._overtaken[way].clear()
        for one in self._all:
            one.acts = False

    def pass_on(self, way: Way, packet: P) -> None:
        """Send a packet into the link, and apply the active faults to the packet."""
        # Every active fault changes, drops, copies or delays the packet.
        queue, copies, delay, held_back = self._queues[way], 1, 0, False
        for one in self._all:
            fault = one.fault
            if not one.acts or fault.direction not in (way, "both"):
                continue
            if (
                "probability" in KINDS[fault.kind].takes
                and one.generator.random() >= fault.probability
            ):
                continue
            if fault.kind in ("loss", "cut"):
                self.acted[fault.kind] += 1
                return
            if fault.kind in TAMPERING:
                changed = self._tamper.changed(fault, way, packet, one.memory, one.generator)
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
                delay += self._cycles(one.generator.uniform(0.0, fault.delay_s))
            elif fault.kind == "reordering":
                held_back = True
            else:
                continue
            self.acted[fault.kind] += 1
        # Only the fault `reordering` changes the order of packets. All other faults keep the order.
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
        """Remove and return the next packet that arrives in this cycle, or return None."""
        queue = self._queues[way]
        if queue and queue[0][0] <= self._cycle:
            return queue.popleft()[1]
        return None

    def _cycles(self, time: float) -> int:
        return -int(-time // self.period)
