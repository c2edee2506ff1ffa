"""Virtual CiA 402 drives, connected to an arm model: one bus, one CANopen node per joint.

`LocalNode` of canopen provides the SDO server, the object dictionary and the NMT slave. `LocalNode`
sends no PDO on SYNC, and it sends heartbeats from a thread. Therefore this module sends PDOs and
heartbeats itself, in the cycle of the facility. In each cycle, all received frames are handled in
the order of their arrival. On a SYNC, the measurements of the last cycle are sent as TPDOs. Then
the targets that were received before the SYNC are applied.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import canopen
import numpy as np
from canopen.sdo.exceptions import SdoAbortedError, SdoError

from freeflyer.fmi.component import Array
from freeflyer_adapters.can.link import open_bus
from freeflyer_adapters.cia402 import objects, process_data
from freeflyer_adapters.cia402.network import PolledNetwork
from freeflyer_adapters.cia402.objects import Entry
from freeflyer_adapters.cia402.options import DriveOptions, options_from
from freeflyer_adapters.cia402.scaling import Scaling
from freeflyer_adapters.cia402.state_machine import statusword_of
from freeflyer_adapters.device.ramp_down import RampDown
from freeflyer_adapters.facility.can_faults import OF_DRIVES, FaultyBus, Untouched
from freeflyer_adapters.facility.drive_logic import DriveGroup, DriveLogic
from freeflyer_adapters.facility.link_faults import LinkFaults
from freeflyer_adapters.facility.settings import FacilitySettings
from freeflyer_adapters.facility.virtual_device import VirtualDevice, arm_ports
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.histogram import Histogram

INITIALISING, PRE_OPERATIONAL, OPERATIONAL = 0, 127, 5
MOST_TORQUE = 3000
"""Object 6072h: peak torque [per mille of the rated torque], typical for servo motors."""
VALUE_RANGE, WRONG_STATE = 0x06090030, 0x08000022
"""SDO abort codes."""
MEASURED = (objects.POSITION.index, objects.VELOCITY.index, objects.ACTUAL_TORQUE.index)


class VirtualDrive:
    """A CANopen node: a `DriveLogic`, and a `LocalNode` of canopen for its communication."""

    def __init__(
        self,
        node_id: int,
        joint: int,
        options: DriveOptions,
        logic: DriveLogic,
        network: PolledNetwork,
    ) -> None:
        self.node_id = node_id
        self.options, self.motor, self.logic = options, options.motors[joint], logic
        self.raw: dict[int, int] = dict.fromkeys(MEASURED, 0)
        """Measurements of the last cycle in the drive's units, by object index."""
        self.node = canopen.LocalNode(node_id, objects.dictionary(options.eds, node_id))
        self.node.add_read_callback(self._read)  # type: ignore[no-untyped-call]
        self.node.add_write_callback(self._written)  # type: ignore[no-untyped-call]
        network.add_node(self.node)
        self._network = network
        self._pending: dict[int, int] = {}
        """Values from the RPDOs since the last SYNC, by object index."""
        self._since_heartbeat = 0.0
        self._was_operational = False
        for maps in (self.node.rpdo, self.node.tpdo):
            for pdo in maps.values():
                pdo.add_callback(self._take)
        self._power_on()

    def _power_on(self) -> None:
        """Set the objects to rated and default values. `advance` then sends the boot-up message."""
        m = self.motor
        self.node.data_store.clear()
        for entry, value in (
            (objects.RATED_TORQUE, round(1e3 * m.rated_torque)),
            (objects.MAX_TORQUE, MOST_TORQUE),
            (objects.ENCODER_INCREMENTS, round(m.encoder_resolution)),
            (objects.ENCODER_TURNS, 1),
            (objects.GEAR_MOTOR_TURNS, round(m.gear_ratio)),
            (objects.GEAR_SHAFT_TURNS, 1),
        ):
            self.set(entry, value)
        self.node.nmt._state = INITIALISING

    def set(self, entry: Entry, value: int) -> None:
        """Set an object from inside the drive, without a check of access rights."""
        variable = self.node.object_dictionary.get_variable(entry.index, entry.sub)
        assert variable is not None
        self.node.data_store.setdefault(entry.index, {})[entry.sub] = variable.encode_raw(value)

    def get(self, entry: Entry) -> int:
        return int.from_bytes(self.node.get_data(entry.index, entry.sub), "little")

    @property
    def statusword(self) -> int:
        return statusword_of(self.logic.state)

    def _read(self, *, index: int, subindex: int, od: Any) -> int | None:
        if index == objects.STATUSWORD.index:
            return self.statusword
        if index == objects.ERROR_CODE.index:
            return self.logic.error
        if index == objects.MODE_DISPLAY.index:
            return self.get(objects.MODE)
        return self.raw.get(index)

    def _written(self, *, index: int, subindex: int, od: Any, data: bytes) -> None:
        """Check an SDO download, before canopen stores it. Raises SdoAbortedError to reject it."""
        value = int.from_bytes(
            data, "little", signed=index in (objects.MODE.index, objects.QUICK_STOP.index)
        )
        if index == objects.MODE.index and value not in (0, objects.CYCLIC_SYNCHRONOUS_TORQUE):
            raise SdoAbortedError(VALUE_RANGE)
        if index == objects.QUICK_STOP.index and value != objects.RAMP_AND_DISABLE:
            raise SdoAbortedError(VALUE_RANGE)
        if 0x1400 <= index < 0x1C00 and self.node.nmt._state == OPERATIONAL:
            raise SdoAbortedError(WRONG_STATE)
        if index == objects.CONTROLWORD.index:
            self.logic.apply_controlword(value)

    # Frames

    def _take(self, pdo: Any) -> None:
        """Store the values of an RPDO for the next SYNC.

        An asynchronous RPDO (transmission type above 240) is applied at once.
        """
        if (
            self.node.nmt._state != OPERATIONAL
            or pdo not in self.node.rpdo.values()
            or len(pdo.data) * 8 < pdo.length
        ):
            return
        self._pending |= {variable.index: variable.raw for variable in pdo}
        if pdo.trans_type is not None and pdo.trans_type > 240:
            self._apply()

    def on_sync(self) -> None:
        """Send the synchronous TPDOs, then apply the last RPDO."""
        if self.node.nmt._state != OPERATIONAL:
            return
        for pdo in self.node.tpdo.values():
            if pdo.enabled and pdo.trans_type is not None and 1 <= pdo.trans_type <= 240:
                for variable in pdo:
                    variable.raw = (
                        self.statusword
                        if variable.index == objects.STATUSWORD.index
                        else self._value(variable.index)
                    )
                pdo.transmit()
        self._apply()

    def _value(self, index: int) -> int:
        if index in self.raw:
            return self.raw[index]
        if index == objects.MODE_DISPLAY.index:
            return self.get(objects.MODE)
        return self.logic.error if index == objects.ERROR_CODE.index else 0

    def _apply(self) -> None:
        controlword, raw = (
            self._pending.get(objects.CONTROLWORD.index),
            self._pending.get(objects.TARGET_TORQUE.index, 0),
        )
        most = self.get(objects.MAX_TORQUE)
        has_mode = self.get(objects.MODE) == objects.CYCLIC_SYNCHRONOUS_TORQUE
        target = min(max(raw, -most), most) * self.motor.torque_step if has_mode else 0.0
        self.logic.synchronise(controlword, target)
        self._pending.clear()

    def on_host_heartbeat(self, can_id: int) -> None:
        """Handle a heartbeat with the identifier `can_id`.

        Restart the watchdog if the sender is the host whose node ID is in object 1016h.
        """
        watched = self.get(objects.CONSUMER_HEARTBEAT)
        self.logic.heartbeat_timeout = 1e-3 * (watched & 0xFFFF)
        if can_id == process_data.HEARTBEAT + (watched >> 16 & 0x7F):
            self.logic.restart_host_watchdog()

    def advance(self) -> None:
        """Handle NMT, heartbeat and EMCY. Call this once per tick."""
        nmt = self.node.nmt
        if nmt._state == INITIALISING:
            self._power_on()
            self.logic.disarm_host_watchdog()
            nmt.send_command(0x81)  # the node then sends its boot-up message
            nmt.state = "PRE-OPERATIONAL"
        if (nmt._state == OPERATIONAL) != self._was_operational:
            self._was_operational = nmt._state == OPERATIONAL
            self._start() if self._was_operational else self._leave()
        self._since_heartbeat += self.logic.tick
        every = 1e-3 * self.get(objects.PRODUCER_HEARTBEAT)
        if every and self._since_heartbeat >= every - 0.5 * self.logic.tick:
            self._since_heartbeat = 0.0
            self._network.send_message(process_data.HEARTBEAT + self.node_id, bytes([nmt._state]))
        if self.logic.new_error is not None:
            self.node.emcy.send(self.logic.new_error, 1 if self.logic.new_error else 0)
            self.logic.new_error = None

    def _start(self) -> None:
        """Read the PDO mapping from the drive's own objects. Called at NMT start."""
        for maps in (self.node.rpdo, self.node.tpdo):
            for pdo in maps.values():
                try:
                    pdo.read()
                except SdoError:
                    pdo.enabled = False
        self._pending.clear()
        self.logic.sync_period = 1e-6 * self.get(objects.SYNC_PERIOD)

    def _leave(self) -> None:
        """Stop an enabled drive. Outside the NMT state Operational, a drive receives no PDO."""
        if not self.logic.braked:
            self.logic.fail(objects.SYNC_LOST)


class VirtualCia402(VirtualDevice[DriveGroup]):
    """A virtual arm of CiA 402 drives."""

    fault_kinds = OF_DRIVES

    def __init__(
        self,
        name: str,
        raw: Mapping[str, Any],
        directory: Path,
        settings: FacilitySettings,
        period: float,
    ) -> None:
        self.name, self.settings, self.period = name, settings, period
        self._environment = environment.present()
        self.options = o = options_from(name, raw, directory)
        n = o.joints
        self.scaling = Scaling(o.motors)
        # Ports that are connected to the model.
        self.commands, self.measurements = arm_ports(n)
        self.syncs = 0
        self.answers = Histogram()
        """Time from the kernel's time stamp of a SYNC to the sending of the last TPDO."""
        # Create the bus with faults, then one node per joint on this bus.
        self._velocity = np.zeros(n)
        self.logic = self._new_logic()
        self.faults = LinkFaults(settings.faults_of(name), period, settings.seed, Untouched())
        bus = open_bus(o.interface, o.channel, False, [], {"bitrate": int(o.bitrate), **o.bus})
        self._bus = FaultyBus(bus, self.faults)
        self.begin_faults(self.faults, self._bus)
        network = self._network = PolledNetwork(self._bus)
        try:
            self.drives = [
                VirtualDrive(node, joint, o, logic, network)
                for joint, (node, logic) in enumerate(
                    zip(o.node_ids, self.logic.drives, strict=True)
                )
            ]
        except BaseException:
            network.disconnect()
            raise
        # Any node that is not a drive may be the host. Receive the heartbeats of all such nodes.
        network.subscribe(process_data.SYNC, self._on_sync)
        for node in range(1, 128):
            if node not in o.node_ids:
                network.subscribe(process_data.HEARTBEAT + node, self._on_heartbeat)

    def _new_logic(self) -> DriveGroup:
        s = self.settings
        ramp = RampDown(time=s.ramp_down_time_s, damping=s.ramp_down_damping)
        drives = [
            DriveLogic(tick=self.period, watchdog=s.arm_watchdog_cycles, ramp=ramp)
            for _ in self.options.node_ids
        ]
        return DriveGroup(drives, round(s.forget_after_s / self.period))

    def begin_session(self, parameters: Mapping[str, Array]) -> None:
        """Start a session. The robot is at its start pose, and the drives restart."""
        self.logic = self._new_logic()
        self.begin_faults(self.faults, self._bus)
        self._velocity[:] = 0.0
        for drive, logic in zip(self.drives, self.logic.drives, strict=True):
            drive.logic = logic
            drive.node.nmt._state = INITIALISING

    def fail(self, joint: int = 1, code: int = 0x2310) -> None:
        """Cause a fault. `joint` counts from 1. `code` is an error code of CiA 402."""
        self.logic.drives[joint - 1].fail(code)

    def power_off(self) -> None:
        for drive in self.logic.drives:
            drive.power_off()

    def receive(self, values: Mapping[str, Array]) -> None:
        if self.begin_cycle():
            self._network.drain()
            self.logic.advance(self._velocity)
        values["joint_torque_command"][:] = self.logic.torque
        values["brake"][0] = float(self.logic.braked)

    def _on_sync(self, can_id: int, data: Any, timestamp: float) -> None:
        self.syncs += 1
        for drive in self.drives:
            drive.on_sync()
        late = self._environment.time_ns() * 1e-9 - timestamp
        if 0.0 <= late < 1.0:
            self.answers.add(int(1e9 * late))

    def _on_heartbeat(self, can_id: int, data: Any, timestamp: float) -> None:
        for drive in self.drives:
            drive.on_host_heartbeat(can_id)

    def send(self, values: Mapping[str, Array]) -> None:
        self._velocity[:] = values["joint_velocity"]
        self._bus.flush()
        if self._bus.silent:
            return
        s = self.scaling
        columns = zip(
            np.rint(values["joint_position"] / s.position_step).tolist(),
            np.rint(values["joint_velocity"] / s.velocity_step).tolist(),
            np.rint(values["joint_torque"] / s.torque_step).tolist(),
            strict=True,
        )
        for drive, column in zip(self.drives, columns, strict=True):
            drive.raw = dict(zip(MEASURED, map(int, column), strict=True))
            drive.advance()

    def report(self) -> Mapping[str, float]:
        return {
            "cycle": float(self.logic.cycle),
            "syncs": float(self.syncs),
            "frames_not_taken_by_the_interface": float(self._network.failed),
        }

    def histograms(self) -> Mapping[str, Histogram]:
        return {f"{self.name}: all TPDOs sent after SYNC": self.answers}

    def close(self) -> None:
        self._network.disconnect()
