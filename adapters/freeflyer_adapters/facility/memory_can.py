"""CAN bus in memory. While a node waits for a frame, the virtual time advances."""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

import can

LONGEST = 10_000
"""Maximum number of unread frames of a node.

Further frames are lost, in the same way as in a CAN controller whose receive buffer is full."""


class Time(Protocol):
    def time_ns(self) -> int: ...

    def pass_until(self, duration: float, happened: Callable[[], bool]) -> bool: ...


class MemoryBus(can.BusABC):
    """A node of a CAN channel. Frames arrive without delay and in order.

    `nodes` is the list of all nodes. A new node adds itself to this list.
    """

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
        """Return the next frame, or None if no frame arrives.

        `timeout` is a virtual time [s]. If `timeout` is None or zero, `recv` does not wait.
        """
        if not self._queue and timeout:
            self._time.pass_until(timeout, lambda: bool(self._queue))
        return self._queue.popleft() if self._queue else None

    def shutdown(self) -> None:
        if self in self._nodes:
            self._nodes.remove(self)
        super().shutdown()
