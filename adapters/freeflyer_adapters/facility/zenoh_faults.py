"""Faults on Zenoh: a link of a base robot that loses, delays, duplicates or changes samples."""

from __future__ import annotations

import random
import struct
from dataclasses import replace
from typing import Any

from freeflyer_adapters.base import rmw_zenoh
from freeflyer_adapters.base.link import OdometryLink
from freeflyer_adapters.base.ros_messages import NUMBERS
from freeflyer_adapters.base.sealed_odometry import sealed
from freeflyer_adapters.facility.faults import Fault
from freeflyer_adapters.facility.link_faults import LinkFaults, Way

FAULT_KINDS = ("loss", "delay", "jitter", "duplication", "reordering", "flipped_bits", "wrong_data_id", "stale_stamp",
               "frozen_counter", "not_a_number", "out_of_range", "clock_jump", "cut", "hung", "dead")  # fmt: skip
Sample = tuple[bytes, bytes]
"""Payload and attachment."""


class ZenohTamper:
    """Implementation of `Tamper` for samples.

    The fault `flipped_bits` stands for a disturbance on the link. It changes bits and keeps the old
    checksum. All other faults stand for errors of the sender. After such a fault, the changed
    sample has a correct checksum.
    """

    def changed(
        self,
        fault: Fault,
        way: Way,
        packet: Sample,
        memory: dict[str, Any],
        generator: random.Random,
    ) -> Sample | None:
        payload, raw = packet
        if fault.kind == "flipped_bits":
            both = bytearray(payload + raw)
            for bit in generator.sample(range(8 * len(both)), fault.bits):
                both[bit // 8] ^= 1 << bit % 8
            return bytes(both[: len(payload)]), bytes(both[len(payload) :])
        try:
            attachment = rmw_zenoh.read_attachment(raw)
        except rmw_zenoh.AttachmentError:
            return None
        if fault.kind == "wrong_data_id":
            attachment = replace(attachment, gid=bytes(byte ^ 0x55 for byte in attachment.gid))
        elif fault.kind == "frozen_counter":
            attachment = replace(
                attachment, sequence=memory.setdefault("sequence", attachment.sequence)
            )
        elif fault.kind == "stale_stamp":
            # While this fault is active, all samples have the same stamp. This stamp is 1 ns before
            # the original stamp of the first sample that the fault affects.
            attachment = replace(attachment, stamp=memory.setdefault("stamp", attachment.stamp - 1))
        elif fault.kind == "clock_jump":
            attachment = replace(attachment, stamp=attachment.stamp + round(fault.jump_s * 1e9))
        else:
            value = float("nan") if fault.kind == "not_a_number" else 1e300
            payload = _with_numbers(payload, value)
        return sealed(payload, attachment.pack()), attachment.pack()


def _with_numbers(payload: bytes, value: float) -> bytes:
    """Replace the three numbers of the position by `value`.

    The message ends with `NUMBERS` numbers, and then less than eight bytes of padding. The position
    is the first three of these numbers.
    """
    place = 4 + (len(payload) - 4 - 8 * NUMBERS) // 8 * 8
    order = "<" if payload[1] else ">"
    return payload[:place] + struct.pack(order + "3d", value, value, value) + payload[place + 24 :]


class FaultyOdometryLink(OdometryLink):
    """An `OdometryLink` with faults. The faults act between this object and its Zenoh session."""

    faults: LinkFaults[Sample]
    silent = False
    """Whether the device neither sends nor receives. Incoming samples are then lost."""

    def put(self, payload: bytes, attachment: bytes) -> None:
        if not self.silent:
            self.faults.pass_on("to_controller", (payload, attachment))
            self.flush()

    def flush(self) -> None:
        """Send the samples whose delay has ended."""
        while (sample := self.faults.due("to_controller")) is not None:
            super().put(*sample)

    def take(self) -> Sample | None:
        while (sample := super().take()) is not None:
            if not self.silent:
                self.faults.pass_on("to_device", sample)
        latest = None
        while (sample := self.faults.due("to_device")) is not None:
            latest = sample  # keep only the latest sample, as RingChannel(1) does
        return latest
