"""A CAN bus in memory and in virtual time; waiting for a frame advances the time."""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

import can

LONGEST = 10_000
"""Maximum number of unread frames of a node; further frames are lost, as on a CAN controller."""


class Time(Protocol):
    def time_ns(self) -> int: ...

    def pass_until(self, duration: float, happened: Callable[[], bool]) -> bool: ...


class MemoryBus(can.BusABC):
    """A node of a channel; `nodes` are all its nodes. Frames arrive without delay, in order."""

    def __init__(
        self, channel: str, nodes: list[MemoryBus], time: Time, can_filters: Any = None
    ) -> None:
        self.channel_info = f"channel {channel!r} in virtual time"
        self._nodes, self._time = nodes, time
        self._queue: deque[can.Message] = deque()
        nodes.append(self)
        super().__init__(channel=channel, can_filters=can_filters)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        for node in self._nodes:
            if node is not self and node._matches_filters(msg) and len(node._queue) < LONGEST:
                frame = copy.copy(msg)
                frame.timestamp = self._time.time_ns() * 1e-9
                node._queue.append(frame)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame or None; `timeout` [s] of virtual time, None means no wait."""
        if not self._queue and timeout:
            self._time.pass_until(timeout, lambda: bool(self._queue))
        return self._queue.popleft() if self._queue else None

    def shutdown(self) -> None:
        if self in self._nodes:
            self._nodes.remove(self)
        super().shutdown()
