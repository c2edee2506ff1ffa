"""Faults on CAN. `FaultyBus` is a bus with faults. `CanTamper` changes the content of frames."""

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
"""Maximum number of frames per call of `recv`.

Because of this limit, a flood of frames cannot block a virtual device.
"""
OF_DRIVES = tuple(kind for kind in FAULT_KINDS if kind not in TAMPERING)
STAMPS = {"to_controller": ("cycle",), "to_device": ("answered_cycle",)}
"""Role of the frame field that contains a cycle number, by direction."""
EXTREME = {"to_controller": "joint_position", "to_device": "joint_torque_command"}


class CanTamper:
    """Implementation of `Tamper` for command and state frames. Other frames are not changed."""

    def __init__(self, frames: ArmFrames, period: float) -> None:
        # A frame object stores the values that were packed last. So this class and the arm must not
        # share the object `frames`.
        self._frames = {frame.identifier: frame for frame in (frames.command, frames.state)}
        self._cycles, self._period = frames.cycles, period

    def changed(
        self,
        fault: Fault,
        way: Way,
        packet: can.Message,
        memory: dict[str, Any],
        generator: random.Random,
    ) -> can.Message | None:
        frame = self._frames.get(packet.arbitration_id)
        if frame is None:
            return None
        data: bytearray | None
        if fault.kind == "flipped_bits":
            data = bytearray(packet.data)
            for bit in generator.sample(range(8 * len(data)), min(fault.bits, 8 * len(data))):
                data[bit // 8] ^= 1 << bit % 8
        elif fault.kind in ("wrong_data_id", "frozen_counter"):
            data = self._with_wrong_protection(frame, packet, fault, memory)
        else:
            data = self._with_wrong_values(frame, packet, fault, way, memory)
        if data is None:
            return None
        changed = copy.copy(packet)
        changed.data = data
        return changed

    def _with_wrong_protection(
        self, frame: Frame, packet: can.Message, fault: Fault, memory: dict[str, Any]
    ) -> bytearray | None:
        if frame.data_id is None:
            return None
        data, place = bytearray(packet.data), frame.e2e_offset
        if fault.kind == "frozen_counter":
            data[place + 2] = memory.setdefault("counter", data[place + 2])
            return _protected(data, frame.data_id, place)
        return _protected(data, frame.data_id ^ 0x0101, place)

    def _with_wrong_values(
        self, frame: Frame, packet: can.Message, fault: Fault, way: Way, memory: dict[str, Any]
    ) -> bytearray | None:
        """Return the data of a frame with changed values and a correct E2E protection.

        Return None if the fault changes the cycle number, and the frame contains no cycle number.
        """
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
    """Implementation of `Tamper` for CiA 402 drives. It changes no frame.

    The frames of CiA 402 have no E2E protection. Therefore a host could not detect a changed frame.
    """

    def changed(
        self,
        fault: Fault,
        way: Way,
        packet: can.Message,
        memory: dict[str, Any],
        generator: random.Random,
    ) -> None:
        return None


class FaultyBus:
    """A bus with faults. It has only the methods that virtual devices call. `recv` never waits."""

    state = can.BusState.ACTIVE

    def __init__(self, bus: can.BusABC, faults: LinkFaults[can.Message]) -> None:
        self.bus, self.faults = bus, faults
        self.silent = False
        """Whether the device neither sends nor receives. Incoming frames are then lost."""

    def send(self, message: can.Message) -> None:
        """Send a frame. Raises CanOperationError while the fault `bus_off` is active."""
        if self.faults.acts("bus_off"):
            raise can.CanOperationError("bus off")
        if not self.silent:
            self.faults.pass_on("to_controller", message)
            self.flush()

    def flush(self) -> None:
        """Send the frames whose delay has ended."""
        while (message := self.faults.due("to_controller")) is not None:
            self.bus.send(message)

    def recv(self, timeout: float = 0.0) -> can.Message | None:
        """Return the next frame, after faults were applied, or None. `timeout` is ignored."""
        for _ in range(MOST_FRAMES):
            message = self.bus.recv(0.0)
            if message is None:
                break
            if not (self.silent or self.faults.acts("bus_off")):
                self.faults.pass_on("to_device", message)
        return self.faults.due("to_device")

    def shutdown(self) -> None:
        self.bus.shutdown()
