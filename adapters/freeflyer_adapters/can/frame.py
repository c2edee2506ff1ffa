"""Conversion between the bytes of a DBC message and values in SI units.

Role: name of a quantity in a frame, for example `joint_position`. The names of the signals in a DBC
may be different from the roles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from freeflyer_adapters.can.e2e import HEADER_BYTES
from freeflyer_adapters.can.signals import Field, occupied_bits, only
from freeflyer_adapters.foundation.errors import DeviceError

CAN_FD_SIZES = (*range(9), 12, 16, 20, 24, 32, 48, 64)


class Frame:
    """DBC message whose signals are assigned to roles.

    A role has one signal, or one signal per joint.

    - `fields`: role -> signals.
    - `subject`: name of the message in error messages.
    - `data_id`: data ID of E2E profile 5. If `data_id` is None, the attribute E2eDataId of the
      message is used. A message without a data ID is not protected.
    - `e2e_offset`: first byte of the E2E header.

    Raises DeviceError in these cases:

    - A signal is mapped more than once.
    - The size of the message is not a CAN FD frame size.
    - The E2E header exceeds the message or overlaps a mapped signal.
    """

    def __init__(
        self,
        message: Any,
        fields: Mapping[str, tuple[Field, ...]],
        *,
        subject: str,
        data_id: int | None,
        e2e_offset: int,
    ) -> None:
        self.message, self.fields, self.subject = message, fields, subject
        self.identifier, self.extended = int(message.frame_id), bool(message.is_extended_frame)
        self.size = int(message.length)
        bound = [f.name for group in fields.values() for f in group]
        twice = [name for name in bound if bound.count(name) > 1]
        if twice:
            raise DeviceError(
                f"{subject}: signal {twice[0]} is mapped more than once; one signal for each joint and role is expected"
            )
        self.is_fd = bool(message.is_fd) or self.size > 8
        if self.size not in CAN_FD_SIZES:
            sizes = ", ".join(map(str, CAN_FD_SIZES))
            raise DeviceError(
                f"{subject} has {self.size} bytes, which is not a CAN FD frame size: one of {sizes} is expected"
            )
        attribute = message.dbc.attributes.get("E2eDataId") if message.dbc else None
        self.data_id = (
            data_id
            if data_id is not None
            else int(attribute.value)
            if attribute and attribute.value
            else None
        )
        self.e2e_offset = e2e_offset
        if self.data_id is not None:
            _check_header(message, subject, set(bound), e2e_offset)
        self.cycle_ms = float(message.cycle_time or 0)
        self._codec = only(message, set(bound))
        self._values: dict[str, float] = {
            signal.name: signal.offset for signal in self._codec.signals
        }

    def __contains__(self, role: str) -> bool:
        return role in self.fields

    def pack(self, numbers: Mapping[str, Sequence[float]]) -> bytearray:
        """Return the bytes of the frame. `numbers`: role -> values in SI units.

        Each value is clamped to the range of its signal. A role that is not in `numbers` keeps its
        last values.
        """
        values = self._values
        for role, given in numbers.items():
            for f, value in zip(self.fields.get(role, ()), given, strict=False):
                values[f.name] = min(max(value, f.least), f.most) / f.factor
        return bytearray(self._codec.encode(values, strict=False))

    def unpack(self, data: bytes | bytearray) -> dict[str, list[float]]:
        """Return the values of a frame: role -> values in SI units."""
        values = self._codec.decode(bytes(data), decode_choices=False)
        return {
            role: [f.factor * values[f.name] for f in fields]
            for role, fields in self.fields.items()
        }


def _check_header(message: Any, subject: str, bound: set[str], offset: int) -> None:
    """Raise DeviceError if the E2E header exceeds the frame or overlaps a mapped signal."""
    if not 0 <= offset <= message.length - HEADER_BYTES:
        raise DeviceError(
            f"{subject} has {message.length} bytes; the E2E header of {HEADER_BYTES} bytes at e2e_offset = {offset} does not fit into the frame"
        )
    header = set(range(8 * offset, 8 * (offset + HEADER_BYTES)))
    for signal in message.signals:
        if signal.name in bound and header & occupied_bits(signal):
            raise DeviceError(
                f"{subject}: signal {signal.name} lies in the E2E header (bytes {offset} to {offset + HEADER_BYTES - 1}); choose another "
                f"e2e_offset, or omit data_ids for a frame without protection"
            )
