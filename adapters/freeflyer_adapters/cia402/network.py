"""canopen without threads: its network is fed from a receive of our own, and nothing is sent but by a call.

canopen's `connect` starts a python-can Notifier, a thread that takes the GIL from the loop whenever a frame comes, and its periodic
tasks are threads, too. Here the loop itself receives (`poll`) and hands each frame to canopen's own `notify`; SDO clients poll
while they wait; heartbeats are counted in cycles by who sends them.
"""

from __future__ import annotations

from typing import Any

import can
import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoCommunicationError

from freeflyer_adapters.can.link import driver_message
from freeflyer_adapters.foundation import environment

MOST_FRAMES = 512
"""Taken at a time."""


class PolledNetwork(canopen.Network):
    """Over a bus that is open already; `disconnect` closes it."""

    def __init__(self, bus: Any) -> None:
        """`bus`: with python-can's `send`, `recv` and `shutdown`."""
        super().__init__(bus)
        self.failed = 0
        """Frames that the interface did not take: lost ones, as any other."""
        self.error = ""
        """The driver's own text of the last failure to send or receive."""

    def poll(self, timeout: float) -> bool:
        """Wait for one frame and hand it out; False if none came in time."""
        assert self.bus is not None
        try:
            message = self.bus.recv(max(timeout, 0.0))
        except can.CanError as error:
            self.error = driver_message(error)
            return False
        if message is None:
            return False
        if not (
            message.is_error_frame
            or message.is_remote_frame
            or message.is_extended_id
            or message.is_fd
        ):
            self.notify(message.arbitration_id, message.data, message.timestamp)
        return True

    def drain(self) -> None:
        """Whatever waits already, as far as it is bounded: a flood cannot hold the loop."""
        for _ in range(MOST_FRAMES):
            if not self.poll(0.0):
                return

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        assert self.bus is not None
        message = can.Message(
            arbitration_id=can_id, is_extended_id=False, is_remote_frame=remote, data=data
        )
        try:
            self.bus.send(message)
        except can.CanError as error:
            self.failed += 1
            self.error = driver_message(error)

    def send_periodic(self, can_id: int, data: Any, period: float, remote: bool = False) -> Any:
        """Nothing is sent by itself: the caller's own cycle does it."""
        return _NotPeriodic()


class _NotPeriodic:
    def update(self, data: Any) -> None: ...

    def stop(self) -> None: ...


class PolledSdo(SdoClient):
    """Waits for its answer by polling; the timeout is the caller's."""

    network: PolledNetwork

    def read_response(self) -> Any:
        end = environment.present().monotonic() + self.RESPONSE_TIMEOUT
        while self.responses.empty():
            left = end - environment.present().monotonic()
            if left <= 0.0:
                raise SdoCommunicationError("no answer")
            self.network.poll(left)
        return super().read_response()  # type: ignore[no-untyped-call]


class PolledNode(canopen.RemoteNode):
    """A drive as the host sees it, through canopen, on a polled network."""

    def add_sdo(self, rx_cobid: int, tx_cobid: int) -> Any:
        client = PolledSdo(rx_cobid, tx_cobid, self.object_dictionary)  # type: ignore[no-untyped-call]
        self.sdo_channels.append(client)
        if self.has_network():
            self.network.subscribe(client.tx_cobid, client.on_response)
        return client
