"""Protected frames over a python-can bus: what both ends of the arm's link do alike."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Protocol

import can

from freeflyer.foundation.suggestions import did_you_mean
from freeflyer_adapters.can.e2e import Checker, Protector, Status
from freeflyer_adapters.can.frame import Frame
from freeflyer_adapters.can.second_sender import SecondSender
from freeflyer_adapters.device.device import DeviceError
from freeflyer_adapters.foundation import environment

FILTERING = ("local", "socketcan")
"""Interfaces that filter before `recv` sees a frame. With the others, a frame for somebody else would end a `recv` that does not
wait, so they get no filter; identifiers are compared in any case.
"""
RECENT = 32


def open_bus(
    interface: str,
    channel: str,
    is_fd: bool,
    identifiers: Sequence[Frame],
    options: Mapping[str, Any],
) -> can.BusABC:
    """Any interface of python-can, seeing only the given frames. DeviceError with one sentence if it cannot be opened."""
    known = sorted(can.VALID_INTERFACES)
    if interface not in known:
        raise DeviceError(
            f"CAN interface {interface!r} is not known to python-can{did_you_mean(interface, known)}"
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
    except Exception as error:  # every interface has errors of its own, and of its driver's
        raise DeviceError(
            f"CAN interface {interface!r}, channel {channel!r}, cannot be opened: {driver_message(error)}"
        ) from error


def driver_message(error: Exception) -> str:
    """The driver's own text, on one line."""
    return " ".join(str(error).split())[:300] or type(error).__name__


def flush(bus: can.BusABC | None) -> None:
    """Drop the frames that wait to be sent, where the interface can."""
    if bus is not None:
        with suppress(NotImplementedError, can.CanError):
            bus.flush_tx_buffer()


class Sending(Protocol):
    """What is needed of a bus to send."""

    def send(self, message: can.Message) -> None: ...


class Sender:
    """One kind of frame, protected if it has a data ID."""

    def __init__(self, bus: Sending, frame: Frame) -> None:
        self.bus, self.frame = bus, frame
        self._protector = (
            None if frame.data_id is None else Protector(frame.data_id, frame.e2e_offset)
        )
        self.failed = 0
        self.error = ""
        """The driver's own text of the last failure."""
        self.sent = 0
        self.recent: deque[bytearray] = deque(maxlen=RECENT)
        """What went out last: some interfaces give own frames back."""

    def send(
        self, numbers: Mapping[str, Sequence[float]], permitted: Callable[[], bool] | None = None
    ) -> bool:
        """Whether the interface took the frame; one that it did not take is a lost one, not an end.

        `permitted` is asked when the frame is ready, and only then it goes out.
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
            self.error = driver_message(error)
            return False
        self.sent += 1
        return True


class Receiver:
    """One kind of frame; `rejected` counts by reason those that came but were not used."""

    def __init__(self, frame: Frame) -> None:
        self.frame = frame
        self._checker = None if frame.data_id is None else Checker(frame.data_id, frame.e2e_offset)
        # Without E2E protection a state frame's cycle number serves as its counter.
        self._counts_cycles = self._checker is None and "cycle" in frame
        self._counters = (
            1 << max(int(frame.fields["cycle"][0].most).bit_length(), 5)
            if self._counts_cycles
            else 256
        )
        self.rejected: Counter[str] = Counter()
        self.accepted = 0
        self.senders = SecondSender(self._counters)
        """Sees every whole frame, also those that are not used."""

    @property
    def refused(self) -> int:
        """Frames of this kind that came and were not used."""
        return sum(self.rejected.values())

    def forget(self) -> None:
        """After frames were thrown away unread."""
        if self._checker is not None:
            self._checker.forget()
        self.senders.forget()

    def take(self, message: can.Message) -> dict[str, list[float]] | None:
        """The frame's values by role, or None for one that must not be used."""
        data = message.data
        if (
            message.arbitration_id != self.frame.identifier
            or message.is_extended_id != self.frame.extended
        ):
            return None
        if message.is_error_frame or message.is_remote_frame:
            self.rejected["no data frame"] += 1
            return None
        if len(data) != self.frame.size:
            self.rejected["wrong size"] += 1
            return None
        if self._checker is not None:
            status = self._checker.check(data)
            if status is not Status.wrong_crc:
                self.senders.see(data[self.frame.e2e_offset + 2], data)
            if not status.accepted:
                self.rejected[status.value] += 1
                return None
        self.accepted += 1
        numbers = self.frame.unpack(data)
        if self._counts_cycles:
            self.senders.see(int(numbers["cycle"][0]) % self._counters, data)
        return numbers
