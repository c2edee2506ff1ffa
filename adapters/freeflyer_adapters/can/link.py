"""Transmission and reception of protected frames on a python-can bus.

Both ends of a link use this module.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Protocol

import can

from freeflyer.foundation.errors import one_line
from freeflyer.foundation.keys import ANY, TABLE, TEXT, Key, Keys
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer_adapters.can.e2e import Checker, Protector, Status
from freeflyer_adapters.can.frame import Frame
from freeflyer_adapters.can.second_sender import SecondSender
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.errors import DeviceError

FILTERING = ("local", "socketcan")
"""Interfaces to which `open_bus` gives a filter.

These interfaces themselves remove unwanted frames. If another interface had a filter, python-can's
`recv` would remove the unwanted frames. If `recv` with timeout 0 removes a frame, `recv` returns
None, even if further frames are waiting. Therefore the other interfaces get no filter.
`Receiver.take` compares the identifiers for every interface.
"""
BUS: Keys = {
    "interface": Key(TEXT, "interface of python-can", default="local"),
    "channel": Key(ANY, "channel of the interface", default="freeflyer"),
    "bus": Key(TABLE, "further arguments of the interface, for example bit rates", default={}),
}
"""Keys of every device on a CAN bus."""
RECENT = 32
"""Number of sent frames that `Sender.recent` stores."""


def open_bus(
    interface: str,
    channel: str,
    is_fd: bool,
    identifiers: Sequence[Frame],
    options: Mapping[str, Any],
) -> can.BusABC:
    """Open and return a bus of any python-can interface.

    `is_fd`: whether to enable CAN FD. `identifiers`: frames to receive. `options`: further
    arguments of the interface. Raises DeviceError if the bus cannot be opened.
    """
    valid = sorted(can.VALID_INTERFACES)
    if interface not in valid:
        raise DeviceError(
            f"CAN interface {interface!r} is not supported by python-can{did_you_mean(interface, valid)}"
        )
    filters = [
        {
            "can_id": f.identifier,
            "can_mask": 0x1FFFFFFF if f.extended else 0x7FF,
            "extended": f.extended,
        }
        for f in identifiers
    ]
    try:
        return environment.present().bus(
            interface=interface,
            channel=channel,
            fd=is_fd,
            can_filters=filters if interface in FILTERING else None,
            **options,
        )
    except Exception as error:  # each interface and each driver raises its own exception types
        raise DeviceError(
            f"CAN interface {interface!r}, channel {channel!r}, cannot be opened: {one_line(error, 300)}"
        ) from error


def flush(bus: can.BusABC | None) -> None:
    """Discard the frames that wait for transmission, if the interface has this function."""
    if bus is not None:
        with suppress(NotImplementedError, can.CanError):
            bus.flush_tx_buffer()


class Sending(Protocol):
    """Part of python-can's `BusABC` that `Sender` uses."""

    def send(self, message: can.Message) -> None: ...


class Sender:
    """Sender of one frame type.

    If the frame type has a data ID, E2E profile 5 protects the frames.
    """

    def __init__(self, bus: Sending, frame: Frame) -> None:
        self.bus, self.frame = bus, frame
        self._protector = (
            None if frame.data_id is None else Protector(frame.data_id, frame.e2e_offset)
        )
        self.failed = 0
        self.error = ""
        """The driver's message for the last failure."""
        self.sent = 0
        self.recent: deque[bytearray] = deque(maxlen=RECENT)
        """The last sent frames.

        Some interfaces return the frames that they have sent. The host finds such frames by this
        list.
        """

    def send(
        self, numbers: Mapping[str, Sequence[float]], permitted: Callable[[], bool] | None = None
    ) -> bool:
        """Send one frame. Return whether the frame was sent.

        `numbers`: role -> values in SI units. A role is the name of a quantity in the frame. When
        the frame is ready, `permitted` is called. The frame is sent only if `permitted` returns
        True. If the interface rejects the frame, the frame counts as lost.
        """
        data = self.frame.pack(numbers)
        if self._protector is not None:
            self._protector.protect(data)
        if permitted is not None and not permitted():
            return False
        self.recent.append(data)
        try:
            self.bus.send(
                can.Message(
                    arbitration_id=self.frame.identifier,
                    is_extended_id=self.frame.extended,
                    is_fd=self.frame.is_fd,
                    bitrate_switch=self.frame.is_fd,
                    data=data,
                )
            )
        except can.CanError as error:
            self.failed += 1
            self.error = one_line(error, 300)
            return False
        self.sent += 1
        return True


class Receiver:
    """Receiver of one frame type. `rejected`: reason -> number of rejected frames."""

    def __init__(self, frame: Frame) -> None:
        self.frame = frame
        self._checker = None if frame.data_id is None else Checker(frame.data_id, frame.e2e_offset)
        # The detection of a second sender needs a counter in each frame. Without E2E protection,
        # the cycle number of a state frame replaces the E2E counter.
        self._counts_cycles = self._checker is None and "cycle" in frame
        self._counters = (
            1 << max(int(frame.fields["cycle"][0].most).bit_length(), 5)
            if self._counts_cycles
            else 256
        )
        self.rejected: Counter[str] = Counter()
        self.accepted = 0
        self.senders = SecondSender(self._counters)
        """Detector of a second sender of this frame type.

        The detector uses all frames with the correct size and CRC, including frames that are
        rejected for another reason. Without E2E protection, the detector uses the cycle number.
        Frames without E2E protection and without a cycle number are not checked.
        """

    @property
    def refused(self) -> int:
        """Number of received frames of this type that were rejected."""
        return sum(self.rejected.values())

    def reset(self) -> None:
        """Accept any counter in the next frame.

        Call this method after frames were discarded without a check.
        """
        if self._checker is not None:
            self._checker.reset()
        self.senders.reset()

    def take(self, message: can.Message) -> dict[str, list[float]] | None:
        """Return the values of a frame: role -> values in SI units.

        Return None if the frame is rejected or has another identifier.
        """
        data = message.data
        if (
            message.arbitration_id != self.frame.identifier
            or message.is_extended_id != self.frame.extended
        ):
            return None
        if message.is_error_frame or message.is_remote_frame:
            self.rejected["not a data frame"] += 1
            return None
        if len(data) != self.frame.size:
            self.rejected["wrong size"] += 1
            return None
        if self._checker is not None:
            status = self._checker.check(data)
            if status is not Status.wrong_crc:
                self.senders.observe(data[self.frame.e2e_offset + 2], data)
            if not status.accepted:
                self.rejected[status.value] += 1
                return None
        self.accepted += 1
        numbers = self.frame.unpack(data)
        if self._counts_cycles:
            self.senders.observe(int(numbers["cycle"][0]) % self._counters, data)
        return numbers
