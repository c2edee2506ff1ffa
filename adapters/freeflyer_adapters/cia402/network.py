"""canopen network without threads. The caller receives and sends every frame by its own calls.

The function `connect` of canopen starts a Notifier of python-can. The thread of the Notifier takes
the GIL from the loop at each received frame. The periodic tasks of canopen are threads, too.

This module starts no threads. The loop calls `poll`, which receives one frame and passes it to the
function `notify` of canopen. An SDO client also calls `poll` while it waits for its response. There
are no timers for heartbeats: the sender of a heartbeat counts the cycles between two heartbeats.
"""

from __future__ import annotations

from typing import Any

import can
import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoCommunicationError

from freeflyer.foundation.errors import one_line
from freeflyer_adapters.foundation import environment

MOST_FRAMES = 512
"""Largest number of frames that one call of `drain` processes."""


class PolledNetwork(canopen.Network):
    """Network on an open bus. `disconnect` closes the bus."""

    def __init__(self, bus: Any) -> None:
        """Use `bus`: an object with the methods `send`, `recv` and `shutdown` of python-can."""
        super().__init__(bus)
        self.failed = 0
        """Number of frames that the interface rejected. These frames count as lost."""
        self.error = ""
        """The driver's message for the last failed transmission or reception."""

    def poll(self, timeout: float) -> bool:
        """Receive and process one frame. Return False if no frame arrived within `timeout` [s]."""
        assert self.bus is not None
        try:
            message = self.bus.recv(max(timeout, 0.0))
        except can.CanError as error:
            self.error = one_line(error, 300)
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
        """Process the pending frames.

        The number of processed frames is limited, so that a flood cannot block the loop.
        """
        for _ in range(MOST_FRAMES):
            if not self.poll(0.0):
                return

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Send a frame. A frame that the interface rejects is counted in `failed`."""
        assert self.bus is not None
        message = can.Message(
            arbitration_id=can_id, is_extended_id=False, is_remote_frame=remote, data=data
        )
        try:
            self.bus.send(message)
        except can.CanError as error:
            self.failed += 1
            self.error = one_line(error, 300)

    def send_periodic(self, can_id: int, data: Any, period: float, remote: bool = False) -> Any:
        """Return a task that sends nothing. The caller itself sends the frames, in its cycles."""
        return _NotPeriodic()


class _NotPeriodic:
    def update(self, data: Any) -> None: ...

    def stop(self) -> None: ...


class PolledSdo(SdoClient):
    """SDO client that polls the network for its response, for at most RESPONSE_TIMEOUT."""

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
    """canopen's remote node of a drive, on a polled network."""

    def add_sdo(self, rx_cobid: int, tx_cobid: int) -> Any:
        client = PolledSdo(rx_cobid, tx_cobid, self.object_dictionary)  # type: ignore[no-untyped-call]
        self.sdo_channels.append(client)
        if self.has_network():
            self.network.subscribe(client.tx_cobid, client.on_response)
        return client
