"""One drive as the host sees it: what it is, compared by SDO; how it is set up; and what it says in every cycle."""

from __future__ import annotations

from typing import Any

from canopen.sdo.exceptions import SdoAbortedError, SdoError

from freeflyer_adapters.cia402 import objects, process_data
from freeflyer_adapters.cia402.drive_session import DriveSession
from freeflyer_adapters.cia402.network import PolledNetwork, PolledNode
from freeflyer_adapters.cia402.objects import Entry
from freeflyer_adapters.cia402.options import DriveOptions
from freeflyer_adapters.cia402.process_data import ACTUAL, ON_SYNC, SPEED, TARGET, ProcessData
from freeflyer_adapters.cia402.state_machine import (
    FAULT_RESET,
    POWERED,
    Command,
    DriveState,
    state_of,
)
from freeflyer_adapters.device.device import DeviceError
from freeflyer_adapters.device.permit import Permit

NOT_VALID = 1 << 31
"""In a PDO's COB-ID: it is off."""
HEARTBEATS_MISSED = 2.5
"""A heartbeat is missing after so many of its periods, at both ends."""


class RemoteDrive:
    """`torque`, `position`, `velocity` are raw numbers of the newest TPDOs; `fresh` while those of the present SYNC are there."""

    def __init__(
        self,
        arm: str,
        joint: int,
        node_id: int,
        options: DriveOptions,
        network: PolledNetwork,
        patience: float,
        permit: Permit,
    ) -> None:
        self.who = f"drive of joint {joint + 1} (node {node_id})"
        self.where = f"{arm}: {self.who}"
        self.joint, self.node_id, self.options = joint, node_id, options
        self.motor = options.motors[joint]
        self.node = PolledNode(node_id, objects.dictionary(options.eds, node_id))
        self.node.sdo.RESPONSE_TIMEOUT = patience
        network.add_node(self.node)
        self._network = network
        self._expected = 1 + options.measured_velocity
        self._came: set[int] = set()
        self.torque = self.position = self.velocity = 0
        self.session = DriveSession(permit, self.who)
        self.statusword = 0
        self.emergency = 0
        """Error code of the last EMCY that was none of all-clear; 0 once it is cleared."""
        self.emergencies = 0
        self.accepted = 0
        self.cycles_since_heartbeat = 0
        network.subscribe(ACTUAL.base + node_id, self._on_actual)
        network.subscribe(SPEED.base + node_id, self._on_speed)
        network.subscribe(process_data.SYNC + node_id, self._on_emergency)
        network.subscribe(process_data.HEARTBEAT + node_id, self._on_heartbeat)

    @property
    def state(self) -> DriveState | None:
        """None before the first statusword, and for a pattern that the standard does not have."""
        return self.session.state

    # Before anything moves

    def identify(self) -> None:
        """The device is a drive of this profile, with the scenario's motor, and nobody drives it. DeviceError with both numbers."""
        device_type = self.read(objects.DEVICE_TYPE)
        if device_type & 0xFFFF != 402:
            raise DeviceError(
                f"{self.where} is of device profile {device_type & 0xFFFF} (1000h is 0x{device_type:08X}); a drive of profile 402 is expected"
            )
        if (
            self._has(objects.SUPPORTED_MODES)
            and not self.read(objects.SUPPORTED_MODES) & objects.SUPPORTS_TORQUE
        ):
            raise DeviceError(
                f"{self.where} has no cyclic synchronous torque mode: bit 9 of its supported drive modes ({objects.SUPPORTED_MODES}) is 0"
            )
        self._read_state()
        if self.state is not None and self.powered:
            raise DeviceError(
                f"{self.where} is in {self.state.value} already: another controller drives it; stop that one first"
            )

    def _read_state(self) -> None:
        self.statusword = self.read(objects.STATUSWORD)
        self.session.report(state_of(self.statusword))

    def measure(self) -> None:
        """Statusword and measurements by SDO, which changes nothing in the drive."""
        self._read_state()
        self.torque, self.position = self.read(objects.ACTUAL_TORQUE), self.read(objects.POSITION)
        if self.options.measured_velocity:
            self.velocity = self.read(objects.VELOCITY)
        self._came |= {ACTUAL.number, SPEED.number}

    def reset_fault(self) -> None:
        """Reset a fault once: the rising edge of bit 7 by SDO, before PDOs are processed. DeviceError if it stays."""
        if self.state is not DriveState.fault:
            return
        for word in (Command.disable_voltage.value, FAULT_RESET, Command.disable_voltage.value):
            self.write(objects.CONTROLWORD, word)
        self.emergency = 0
        self._read_state()
        if self.state is DriveState.fault:
            raise DeviceError(
                f"{self.where} stays in {self.says} after a fault reset{self.error_code}; find its cause first"
            )

    @property
    def error_code(self) -> str:
        """What the drive itself says of its error, to end a sentence with."""
        if objects.ERROR_CODE.index not in self.node.object_dictionary:
            return ""
        try:
            code = self.read(objects.ERROR_CODE)
        except DeviceError:
            return "; it gives no error code"
        return (
            f"; its error code ({objects.ERROR_CODE}) is {objects.error_text(code)}" if code else ""
        )

    def compare(self, effort: float) -> None:
        """The drive's own scales against the scenario's; `effort` [N m] is the largest torque that the joint may be given."""
        m = self.motor
        rated = 1e-3 * self.read(objects.RATED_TORQUE)
        self._same("rated torque", rated, m.rated_torque, "N m", objects.RATED_TORQUE, 0.5e-3)
        gear = self._ratio(objects.GEAR_MOTOR_TURNS, objects.GEAR_SHAFT_TURNS)
        self._same(
            "gear ratio", gear, m.gear_ratio, "", objects.GEAR_MOTOR_TURNS, 1e-9 * m.gear_ratio
        )
        encoder = self._ratio(objects.ENCODER_INCREMENTS, objects.ENCODER_TURNS)
        self._same(
            "encoder resolution",
            encoder,
            m.encoder_resolution,
            "increments",
            objects.ENCODER_INCREMENTS,
            1e-9 * m.encoder_resolution,
        )
        most = self.read(objects.MAX_TORQUE) * m.torque_step
        if most < effort * (1.0 - 1e-3):
            raise DeviceError(
                f"{self.where}: its max torque ({objects.MAX_TORQUE}) is {most:.4g} N m at the joint, but the scenario's robot may be given "
                f"{effort:.4g} N m (joint_effort_limit): raise the one or lower the other"
            )

    def _same(
        self, what: str, theirs: float, ours: float, unit: str, entry: Entry, tolerance: float
    ) -> None:
        if not abs(theirs - ours) <= tolerance:
            raise DeviceError(
                f"{self.where}: its {what} ({entry}) is {theirs:.9g} {unit}".rstrip()
                + f", but the scenario's is {ours:.9g} {unit}".rstrip()
                + "; it is another drive, or one of the two is set wrongly"
            )

    def _ratio(self, above: Entry, below: Entry) -> float:
        divisor = self.read(below)
        if divisor == 0:
            raise DeviceError(f"{self.where}: its {below.name.lower()} ({below}) is 0")
        return self.read(above) / divisor

    def set_up(self, cycle: float) -> None:
        """Mode, cycle, heartbeats and PDOs, in NMT state pre-operational."""
        self.node.nmt.state = "PRE-OPERATIONAL"
        self.write(objects.MODE, objects.CYCLIC_SYNCHRONOUS_TORQUE)
        mode = self.read(objects.MODE_DISPLAY)
        if mode != objects.CYCLIC_SYNCHRONOUS_TORQUE:
            raise DeviceError(
                f"{self.where} stays in mode {mode} ({objects.MODE_DISPLAY}); mode 10, cyclic synchronous torque, was written"
            )
        self.write(objects.QUICK_STOP, objects.RAMP_AND_DISABLE)
        value, index = _period(cycle)
        self.write(objects.PERIOD_VALUE, value)
        self.write(objects.PERIOD_INDEX, index)
        if self._has(objects.SYNC_PERIOD):
            self.write(objects.SYNC_PERIOD, round(1e6 * cycle))
        heartbeat = self.options.heartbeat
        self.write(
            objects.CONSUMER_HEARTBEAT,
            self.options.host_node_id << 16 | round(1e3 * HEARTBEATS_MISSED * heartbeat),
        )
        self.write(objects.PRODUCER_HEARTBEAT, round(1e3 * heartbeat))
        self._map(self.node.rpdo, TARGET, used=True)
        self._map(self.node.tpdo, ACTUAL, used=True)
        self._map(self.node.tpdo, SPEED, used=self.options.measured_velocity)
        self._silence_others()
        self.cycles_since_heartbeat = 0

    def _silence_others(self) -> None:
        """PDOs that the drive has besides these would take bus time that nobody has counted."""
        for maps, used in (
            (self.node.rpdo, {TARGET.number}),
            (self.node.tpdo, {ACTUAL.number, SPEED.number}),
        ):
            for number, pdo in maps.items():
                if number in used:
                    continue
                try:
                    cob_id = pdo.com_record[1].raw
                    if not cob_id & NOT_VALID:
                        pdo.com_record[1].raw = cob_id | NOT_VALID
                except SdoError as error:
                    record = f"its further PDO ({pdo.com_record.od.index:04X}h)"
                    raise DeviceError(
                        self._refused("does not switch off", record, error)
                    ) from error

    def _map(self, maps: Any, pdo: ProcessData, *, used: bool) -> None:
        """canopen writes the mapping: PDO off, count 0, entries, count, PDO on."""
        what = f"the mapping of {pdo.name}"
        try:
            chosen = maps[pdo.number]
            chosen.cob_id, chosen.enabled, chosen.trans_type, chosen.rtr_allowed = (
                pdo.base + self.node_id,
                used,
                ON_SYNC,
                False,
            )
            chosen.clear()
            for entry, bits in pdo.mapping:
                chosen.add_variable(entry.index, entry.sub, bits)
            chosen.save()
        except KeyError as error:
            if not used:
                return
            raise DeviceError(f"{self.where}: its EDS has no {pdo.name}") from error
        except SdoError as error:
            raise DeviceError(self._refused("does not take", what, error)) from error
        finally:
            # canopen would copy every frame behind a lock; these are taken by `_on_actual` and `_on_speed`.
            for subscribers in self._network.subscribers.values():
                subscribers[:] = [
                    s
                    for s in subscribers
                    if getattr(s, "__self__", None) not in maps.map.maps.values()
                ]

    def _has(self, entry: Entry) -> bool:
        return self.node.object_dictionary.get_variable(entry.index, entry.sub) is not None

    def read(self, entry: Entry) -> int:
        """One object by SDO; DeviceError that says which drive and object."""
        try:
            return int(self._variable(entry).raw)
        except (SdoError, ValueError, TypeError) as error:
            raise DeviceError(
                self._refused("does not give", f"{entry.name.lower()} ({entry})", error)
            ) from error

    def write(self, entry: Entry, value: int) -> None:
        try:
            self._variable(entry).raw = value
        except (SdoError, ValueError) as error:
            raise DeviceError(
                self._refused(
                    f"does not take {value} for", f"{entry.name.lower()} ({entry})", error
                )
            ) from error

    def _variable(self, entry: Entry) -> Any:
        found = self.node.sdo[entry.index]
        return found[entry.sub] if entry.sub else found

    def _refused(self, verb: str, what: str, error: Exception) -> str:
        if isinstance(error, SdoAbortedError):
            return f"{self.where} {verb} {what}: SDO abort, {' '.join(str(error).split())}"
        if isinstance(error, SdoError):
            return (
                f"{self.where} {verb} {what}: no answer within {self.node.sdo.RESPONSE_TIMEOUT:g} s; is the drive (or `freeflyer facility`) "
                f"running on CAN {self.options.interface}:{self.options.channel}, at this bit rate and node number?"
            )
        return f"{self.where} {verb} {what}: {' '.join(str(error).split())}"

    # Every cycle

    def expect(self) -> None:
        """A SYNC goes out: what has come belongs to the last one."""
        self._came.clear()
        self.cycles_since_heartbeat += 1

    @property
    def fresh(self) -> bool:
        return len(self._came) >= self._expected

    def _on_actual(self, can_id: int, data: Any, timestamp: float) -> None:
        if len(data) != ACTUAL.layout.size:
            return
        self.statusword, self.torque, self.position = ACTUAL.layout.unpack(data)
        self.session.report(state_of(self.statusword))
        self.accepted += 1
        self._came.add(ACTUAL.number)

    def _on_speed(self, can_id: int, data: Any, timestamp: float) -> None:
        if len(data) == SPEED.layout.size:
            (self.velocity,) = SPEED.layout.unpack(data)
            self._came.add(SPEED.number)

    def _on_emergency(self, can_id: int, data: Any, timestamp: float) -> None:
        if len(data) >= 2:
            self.emergency = int.from_bytes(data[:2], "little")
            self.emergencies += self.emergency != 0

    def _on_heartbeat(self, can_id: int, data: Any, timestamp: float) -> None:
        self.cycles_since_heartbeat = 0

    def send(self, command: Command, raw_torque: int) -> None:
        self._network.send_message(
            TARGET.base + self.node_id, TARGET.layout.pack(command.value, raw_torque)
        )

    @property
    def says(self) -> str:
        """Its state in words, with what it said of an error."""
        state = "a state of no known statusword" if self.state is None else self.state.value
        told = f", EMCY {objects.error_text(self.emergency)}" if self.emergency else ""
        return f"{state} (statusword 0x{self.statusword:04X}{told})"

    @property
    def powered(self) -> bool:
        return self.state in POWERED


def _period(cycle: float) -> tuple[int, int]:
    """60C2h: value and power of ten of a period [s]; DeviceError if a byte cannot hold it."""
    for index in (-3, -4, -5, -6):
        value = cycle / 10.0**index
        if abs(value - round(value)) < 1e-6 and 1 <= round(value) <= 255:
            return round(value), index
    raise DeviceError(
        f"a cycle of {cycle:g} s cannot be written into the interpolation time period (60C2h): 1 to 255 times a power of ten is expected"
    )
