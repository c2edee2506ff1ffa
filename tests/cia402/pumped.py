"""Test bench with host and virtual drives in one thread and in virtual time.

The drives advance by one tick whenever the host waits for a frame.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from freeflyer_adapters.cia402 import arm as arm_module
from freeflyer_adapters.cia402.arm import Cia402Arm
from freeflyer_adapters.cia402.options import options_from
from freeflyer_adapters.facility import virtual_cia402
from freeflyer_adapters.facility.settings import FacilitySettings
from freeflyer_adapters.facility.virtual_cia402 import VirtualCia402

TICK = 0.001
TICKS = 4
"""Ticks of the drives per cycle of the host."""
TABLE: dict[str, Any] = {
    "joints": 2, "node_ids": [3, 7], "rated_torque": [0.5, 0.2], "gear_ratio": 100, "encoder_resolution": 4096, "heartbeat_s": 0.02,
}  # fmt: skip


class Joints:
    """Two joints of 1 kg m^2 behind the drives; a brake stops them immediately."""

    def __init__(self, table: dict[str, Any], watchdog: int = 4) -> None:
        self.virtual = VirtualCia402(
            "arm", table, Path(), FacilitySettings(arm_watchdog_cycles=watchdog), TICK
        )
        n = self.virtual.options.joints
        self.values = {
            p.name: np.array(p.start or (0.0,) * p.size)
            for p in (*self.virtual.commands, *self.virtual.measurements)
        }
        self.position, self.velocity = np.zeros(n), np.zeros(n)
        self.torques: list[np.ndarray] = []
        self.stalled = False
        """The facility hangs: it executes no ticks."""

    def tick(self) -> None:
        if self.stalled:
            return
        self.virtual.receive(self.values)
        torque = self.values["joint_torque_command"].copy()
        self.torques.append(torque)
        self.velocity = (
            np.zeros_like(torque) if self.values["brake"][0] else self.velocity + TICK * torque
        )
        self.position = self.position + TICK * self.velocity
        for name, value in (
            ("joint_position", self.position),
            ("joint_velocity", self.velocity),
            ("joint_torque", torque),
        ):
            self.values[name][:] = value
        self.virtual.send(self.values)


class End:
    """One end of a bus with two nodes. The host's end ticks the drives while it waits."""

    channel_info = "pumped"

    def __init__(self) -> None:
        self.waiting: deque[can.Message] = deque()
        self.other: End | None = None
        self.joints: Joints | None = None
        self.since_sync = TICKS
        self.sent: list[can.Message] = []
        self.dropped: set[int] = set()
        """Identifiers of frames from this end that are lost."""

    def send(self, message: can.Message) -> None:
        self.sent.append(message)
        if message.arbitration_id == 0x80 and self.joints is not None:
            while self.since_sync < TICKS:
                self._tick()
            self.since_sync = 0
        if self.other is not None and message.arbitration_id not in self.dropped:
            self.other.waiting.append(message)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if not self.waiting and self.joints is not None:
            assert self.other is not None
            if self.other.waiting or self.since_sync < TICKS:
                self._tick()
            elif timeout:
                time.sleep(min(timeout, 0.002))
        return self.waiting.popleft() if self.waiting else None

    def _tick(self) -> None:
        assert self.joints is not None
        self.since_sync += 1
        if self.joints.stalled and self.other is not None:
            self.other.waiting.clear()
        self.joints.tick()

    def flush_tx_buffer(self) -> None: ...

    def shutdown(self) -> None: ...


class Pair:
    """Host and drives on one bus."""

    def __init__(self, host: Cia402Arm, joints: Joints, host_end: End, drive_end: End) -> None:
        self.host, self.joints, self.host_end, self.drive_end = host, joints, host_end, drive_end

    @property
    def logics(self) -> list[Any]:
        return list(self.joints.virtual.logic.drives)

    @property
    def drives(self) -> list[Any]:
        return self.joints.virtual.drives

    def prepared(self) -> Pair:
        self.host.configure()
        self.host.check_start()
        self.host.prepare()
        return self

    def activated(self) -> Pair:
        self.prepared().host.activate(lambda: False)
        return self

    def controlwords(self, node_id: int, since: int = 0) -> list[int]:
        """Return the controlwords of the RPDOs that the host has sent to a drive."""
        frames = [m for m in self.host_end.sent[since:] if m.arbitration_id == 0x200 + node_id]
        return [int.from_bytes(m.data[:2], "little") for m in frames]

    def cycle(self, *torque: float) -> None:
        self.host.read()
        if torque:
            self.host.values["joint_torque_command"][:] = torque
        self.host.write()

    def cycles(self, count: int, *torque: float) -> None:
        for _ in range(count):
            self.cycle(*torque)


@contextmanager
def pair(
    patch: pytest.MonkeyPatch, watchdog: int = 4, drives: dict[str, Any] | None = None, **host: Any
) -> Iterator[Pair]:
    """Build a bench. `drives`, `host`: changed keys of TABLE for the drives or the host only.

    `host` may also contain parameters of the device.
    """
    host_end, drive_end = End(), End()
    host_end.other, drive_end.other = drive_end, host_end
    patch.setattr(virtual_cia402, "open_bus", lambda *arguments: drive_end)
    patch.setattr(arm_module, "open_bus", lambda *arguments: host_end)
    joints = Joints({**TABLE, **(drives or {})}, watchdog)
    host_end.joints = joints
    for _ in range(3):
        joints.tick()
    keys = {
        key: value
        for key, value in host.items()
        if key
        in ("velocity", "gear_ratio", "node_ids", "joints", "rated_torque", "largest_load", "eds")
    }
    arm = Cia402Arm("arm", options_from("arm", {**TABLE, **keys}, Path()))
    arm.values["joint_effort_limit"][:] = (100.0, 40.0)
    arm.values["torque_rate_limit"][:] = 1e6
    arm.values["configure_timeout"][:] = 0.3
    arm.values["watchdog_cycles"][:] = 1000  # the host's watchdog uses real time
    for key, value in host.items():
        if key not in keys:
            arm.values[key][:] = value
    try:
        yield Pair(arm, joints, host_end, drive_end)
    finally:
        arm.deactivate()
        joints.virtual.close()
