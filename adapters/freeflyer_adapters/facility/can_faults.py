"""Faults on CAN: a bus between a virtual arm and the real one, and what a broken sender's frames look like."""

from __future__ import annotations

import copy
import random
from typing import Any

import can
from e2e.p05 import e2e_p05_protect

from freeflyer_adapters.arm.frames import ArmFrames
from freeflyer_adapters.can.frame import Frame
from freeflyer_adapters.facility.faults import Fault
from freeflyer_adapters.facility.link_faults import TAMPERING, LinkFaults, Way

FAULT_KINDS = ("loss", "delay", "jitter", "duplication", "reordering", "flipped_bits", "wrong_data_id", "stale_stamp",
               "frozen_counter", "out_of_range", "clock_jump", "cut", "bus_off", "hung", "dead", "device_fault")  # fmt: skip
MOST_FRAMES = 256
"""Taken from the bus at a time, so that a flood cannot hold a virtual device."""
OF_DRIVES = tuple(kind for kind in FAULT_KINDS if kind not in TAMPERING)
STAMPS = {"to_controller": ("cycle",), "to_device": ("answered_cycle",)}
"""The roles that say when a frame was made, by way."""
EXTREME = {"to_controller": "joint_position", "to_device": "joint_torque_command"}


class CanTamper:
    """See `freeflyer_adapters.facility.link_faults.Tamper`; the frames are command and state (others pass as they are)."""

    def __init__(self, frames: ArmFrames, period: float) -> None:
        # Frames keep what they packed last: these are the tamperer's own.
        self._frames = {frame.identifier: frame for frame in (frames.command, frames.state)}
        self._cycles, self._period = frames.cycles, period

    def changed(
        self,
        fault: Fault,
        way: Way,
        packet: can.Message,
        memory: dict[str, Any],
        lot: random.Random,
    ) -> can.Message | None:
        frame = self._frames.get(packet.arbitration_id)
        if frame is None:
            return None
        data: bytearray | None
        if fault.kind == "flipped_bits":
            data = bytearray(packet.data)
            for bit in lot.sample(range(8 * len(data)), min(fault.bits, 8 * len(data))):
                data[bit // 8] ^= 1 << bit % 8
        elif fault.kind in ("wrong_data_id", "frozen_counter"):
            data = self._protected_otherwise(frame, packet, fault, memory)
        else:
            data = self._said_otherwise(frame, packet, fault, way, memory)
        if data is None:
            return None
        changed = copy.copy(packet)
        changed.data = data
        return changed

    def _protected_otherwise(
        self, frame: Frame, packet: can.Message, fault: Fault, memory: dict[str, Any]
    ) -> bytearray | None:
        if frame.data_id is None:
            return None
        data, place = bytearray(packet.data), frame.e2e_offset
        if fault.kind == "frozen_counter":
            data[place + 2] = memory.setdefault("counter", data[place + 2])
            return _protected(data, frame.data_id, place)
        return _protected(data, frame.data_id ^ 0x0101, place)

    def _said_otherwise(
        self, frame: Frame, packet: can.Message, fault: Fault, way: Way, memory: dict[str, Any]
    ) -> bytearray | None:
        """Other values, protected as they should be."""
        numbers = frame.unpack(packet.data)
        if fault.kind == "out_of_range":
            role = EXTREME[way]
            numbers[role] = [f.most for f in frame.fields[role]]
        else:
            role = next((role for role in STAMPS[way] if role in frame), "")
            if not role:
                return None
            if fault.kind == "stale_stamp":
                numbers[role] = memory.setdefault("stamp", numbers[role])
            else:
                jump = round(fault.jump_s / self._period)
                numbers[role] = [float((int(numbers[role][0]) + jump) % self._cycles)]
        data = frame.pack(numbers)
        if frame.data_id is not None:
            data[frame.e2e_offset + 2] = packet.data[frame.e2e_offset + 2]
            data = _protected(data, frame.data_id, frame.e2e_offset)
        return data


def _protected(data: bytearray, data_id: int, offset: int) -> bytearray:
    e2e_p05_protect(data, data_id, offset=offset, increment_counter=False)
    return data


class Untouched:
    """A tamper for frames whose content is left alone: classic CAN's own checksum finds what a cable does, and drives have no more."""

    def changed(
        self,
        fault: Fault,
        way: Way,
        packet: can.Message,
        memory: dict[str, Any],
        lot: random.Random,
    ) -> None:
        return None


class FaultyBus:
    """What a virtual arm's end of the link uses of a bus, with faults in between; `recv` never waits."""

    state = can.BusState.ACTIVE

    def __init__(self, bus: can.BusABC, faults: LinkFaults[can.Message]) -> None:
        self.bus, self.faults = bus, faults
        self.silent = False
        """The device neither sends nor receives; what comes meanwhile is lost."""

    def send(self, message: can.Message) -> None:
        """CanOperationError while the controller is off the bus."""
        if self.faults.acts("bus_off"):
            raise can.CanOperationError("bus off")
        if not self.silent:
            self.faults.pass_on("to_controller", message)
            self.flush()

    def flush(self) -> None:
        """Send what was held back until now."""
        while (message := self.faults.due("to_controller")) is not None:
            self.bus.send(message)

    def recv(self, timeout: float = 0.0) -> can.Message | None:
        for _ in range(MOST_FRAMES):
            message = self.bus.recv(0.0)
            if message is None:
                break
            if not (self.silent or self.faults.acts("bus_off")):
                self.faults.pass_on("to_device", message)
        return self.faults.due("to_device")

    def shutdown(self) -> None:
        self.bus.shutdown()
