"""Host side of one drive.

The host identifies and configures the drive by SDO. In every cycle, the host and the drive exchange
process data.
"""

from __future__ import annotations

from typing import Any

from canopen.sdo.exceptions import SdoAbortedError, SdoError

from freeflyer.foundation.errors import one_line
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
from freeflyer_adapters.device.permit import Permit
from freeflyer_adapters.foundation.errors import DeviceError

NOT_VALID = 1 << 31
"""Bit of a PDO's COB-ID that disables the PDO."""
HEARTBEATS_MISSED = 2.5
"""Time without a heartbeat, in heartbeat periods, after which a node counts as failed.

The host and the drives use the same value.
"""


class RemoteDrive:
    """One drive of an arm.

    `torque`, `position`, `velocity`: raw numbers in the newest TPDOs. `fresh`: whether all TPDOs of
    the drive have arrived since the last SYNC. `timeout`: timeout for an SDO response [s].
    `permit`: the permit that all drives of the arm share (`permit.py`).
    """

    def __init__(
        self,
        arm: str,
        joint: int,
        node_id: int,
        options: DriveOptions,
        network: PolledNetwork,
        timeout: float,
        permit: Permit,
    ) -> None:
        self.label = f"drive of joint {joint + 1} (node {node_id})"
        self.where = f"{arm}: {self.label}"
        self.joint, self.node_id, self.options = joint, node_id, options
        self.motor = options.motors[joint]
        self.node = PolledNode(node_id, objects.dictionary(options.eds, node_id))
        self.node.sdo.RESPONSE_TIMEOUT = timeout
        network.add_node(self.node)
        self._network = network
        self._expected = 1 + options.measured_velocity
        self._received: set[int] = set()
        self.torque = self.position = self.velocity = 0
        self.session = DriveSession(permit, self.label)
        self.statusword = 0
        self.emergency = 0
        """Error code of the last EMCY; 0 after an EMCY that reports the end of the error."""
        self.emergencies = 0
        self.accepted = 0
        self.cycles_since_heartbeat = 0
        network.subscribe(ACTUAL.base + node_id, self._on_actual)
        network.subscribe(SPEED.base + node_id, self._on_speed)
        network.subscribe(process_data.SYNC + node_id, self._on_emergency)
        network.subscribe(process_data.HEARTBEAT + node_id, self._on_heartbeat)

    @property
    def state(self) -> DriveState | None:
        """State of the drive.

        None: no statusword was received, or the last statusword contains no defined state.
        """
        return self.session.state

    # Before the activation

    def identify(self) -> None:
        """Check by SDO that the device is a drive with torque mode, and that it is not enabled.

        Raises DeviceError if a check fails. The message contains the value that was read.
        """
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
                f"{self.where} is in the state {self.state.value} already: another controller has enabled it; stop the other controller first"
            )

    def _read_state(self) -> None:
        self.statusword = self.read(objects.STATUSWORD)
        self.session.report(state_of(self.statusword))

    def measure(self) -> None:
        """Read statusword and measurements by SDO. This changes no object of the drive."""
        self._read_state()
        self.torque, self.position = self.read(objects.ACTUAL_TORQUE), self.read(objects.POSITION)
        if self.options.measured_velocity:
            self.velocity = self.read(objects.VELOCITY)
        self._received |= {ACTUAL.number, SPEED.number}

    def reset_fault(self) -> None:
        """Reset a fault once, by a rising edge of bit 7 of the controlword.

        The controlword is written by SDO, because the drive does not process PDOs yet. Raises
        DeviceError if the fault remains.
        """
        if self.state is not DriveState.fault:
            return
        for value in (Command.disable_voltage.value, FAULT_RESET, Command.disable_voltage.value):
            self.write(objects.CONTROLWORD, value)
        self.emergency = 0
        self._read_state()
        if self.state is DriveState.fault:
            raise DeviceError(
                f"{self.where} stays in {self.status_text} after a fault reset{self.error_code}; remove the cause first"
            )

    @property
    def error_code(self) -> str:
        """Text with the error code of the drive, for the end of a message.

        The text is empty if there is no error.
        """
        if objects.ERROR_CODE.index not in self.node.object_dictionary:
            return ""
        try:
            code = self.read(objects.ERROR_CODE)
        except DeviceError:
            return "; its error code cannot be read"
        return (
            f"; its error code ({objects.ERROR_CODE}) is {objects.error_text(code)}" if code else ""
        )

    def compare(self, effort: float) -> None:
        """Compare the conversion factors and the torque limit of the drive with the scenario.

        `effort`: effort limit of the joint [N m]. Raises DeviceError if the drive does not match
        the scenario. The message contains both values.
        """
        m = self.motor
        rated = 1e-3 * self.read(objects.RATED_TORQUE)
        self._compare_value(
            "rated torque", rated, m.rated_torque, "N m", objects.RATED_TORQUE, 0.5e-3
        )
        gear = self._ratio(objects.GEAR_MOTOR_TURNS, objects.GEAR_SHAFT_TURNS)
        self._compare_value(
            "gear ratio", gear, m.gear_ratio, "", objects.GEAR_MOTOR_TURNS, 1e-9 * m.gear_ratio
        )
        encoder = self._ratio(objects.ENCODER_INCREMENTS, objects.ENCODER_TURNS)
        self._compare_value(
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
                f"{self.where}: the max torque ({objects.MAX_TORQUE}) is {most:.4g} N m at the joint, but the scenario's joint_effort_limit is "
                f"{effort:.4g} N m: raise the max torque or lower joint_effort_limit"
            )

    def _compare_value(
        self, what: str, actual: float, expected: float, unit: str, entry: Entry, tolerance: float
    ) -> None:
        """Raise DeviceError if a value of the drive differs from the scenario."""
        if not abs(actual - expected) <= tolerance:
            raise DeviceError(
                f"{self.where}: the {what} ({entry}) is {actual:.9g} {unit}".rstrip()
                + f", but the scenario has {expected:.9g} {unit}".rstrip()
                + "; this drive is not the scenario's drive, or one of the two values is wrong"
            )

    def _ratio(self, above: Entry, below: Entry) -> float:
        divisor = self.read(below)
        if divisor == 0:
            raise DeviceError(
                f"{self.where}: the {below.name.lower()} ({below}) is 0; a number greater than zero is expected"
            )
        return self.read(above) / divisor

    def set_up(self, cycle: float) -> None:
        """Write mode, cycle [s], heartbeats and PDOs, in the NMT state pre-operational.

        Raises DeviceError if the drive does not accept a value.
        """
        self.node.nmt.state = "PRE-OPERATIONAL"
        self.write(objects.MODE, objects.CYCLIC_SYNCHRONOUS_TORQUE)
        mode = self.read(objects.MODE_DISPLAY)
        if mode != objects.CYCLIC_SYNCHRONOUS_TORQUE:
            raise DeviceError(
                f"{self.where} stays in mode {mode} ({objects.MODE_DISPLAY}); mode 10 (cyclic synchronous torque) is expected"
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
        self._disable_other_pdos()
        self.cycles_since_heartbeat = 0

    def _disable_other_pdos(self) -> None:
        """Disable all PDOs of the drive that the host does not use.

        The computed bus load does not include these PDOs.
        """
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
                        self._sdo_message("does not disable", record, error)
                    ) from error

    def _map(self, maps: Any, pdo: ProcessData, *, used: bool) -> None:
        """Write the mapping of a PDO: the list of the objects in the PDO.

        The PDO is disabled, and the number of objects is set to 0. Then the objects and their
        number are written. Finally, the PDO is enabled if `used` is True. `maps`: canopen's RPDOs
        or TPDOs of the drive.
        """
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
            raise DeviceError(f"{self.where}: the EDS of the drive has no {pdo.name}") from error
        except SdoError as error:
            raise DeviceError(self._sdo_message("does not accept", what, error)) from error
        finally:
            # Remove the handlers of canopen, because they copy every frame under a lock. Here
            # `_on_actual` and `_on_speed` process the frames instead.
            for subscribers in self._network.subscribers.values():
                subscribers[:] = [
                    s
                    for s in subscribers
                    if getattr(s, "__self__", None) not in maps.map.maps.values()
                ]

    def _has(self, entry: Entry) -> bool:
        return self.node.object_dictionary.get_variable(entry.index, entry.sub) is not None

    def read(self, entry: Entry) -> int:
        """Read one object by SDO. Raises DeviceError if the drive does not return a value."""
        try:
            return int(self._variable(entry).raw)
        except (SdoError, ValueError, TypeError) as error:
            raise DeviceError(
                self._sdo_message("does not return", f"{entry.name.lower()} ({entry})", error)
            ) from error

    def write(self, entry: Entry, value: int) -> None:
        """Write one object by SDO. Raises DeviceError if the drive does not accept the value."""
        try:
            self._variable(entry).raw = value
        except (SdoError, ValueError) as error:
            raise DeviceError(
                self._sdo_message(
                    f"does not accept {value} for", f"{entry.name.lower()} ({entry})", error
                )
            ) from error

    def _variable(self, entry: Entry) -> Any:
        found = self.node.sdo[entry.index]
        return found[entry.sub] if entry.sub else found

    def _sdo_message(self, verb: str, what: str, error: Exception) -> str:
        if isinstance(error, SdoAbortedError):
            return f"{self.where} {verb} {what}: SDO abort, {one_line(error)}"
        if isinstance(error, SdoError):
            return (
                f"{self.where} {verb} {what}: no answer within {self.node.sdo.RESPONSE_TIMEOUT:g} s; is the drive (or `freeflyer facility`) "
                f"running on CAN {self.options.interface}:{self.options.channel}, at this bit rate and node number?"
            )
        return f"{self.where} {verb} {what}: {one_line(error)}"

    # In every cycle

    def expect(self) -> None:
        """Start a new cycle. The TPDOs of the previous SYNC no longer count as received."""
        self._received.clear()
        self.cycles_since_heartbeat += 1

    @property
    def fresh(self) -> bool:
        return len(self._received) >= self._expected

    def _on_actual(self, can_id: int, data: Any, timestamp: float) -> None:
        if len(data) != ACTUAL.layout.size:
            return
        self.statusword, self.torque, self.position = ACTUAL.layout.unpack(data)
        self.session.report(state_of(self.statusword))
        self.accepted += 1
        self._received.add(ACTUAL.number)

    def _on_speed(self, can_id: int, data: Any, timestamp: float) -> None:
        if len(data) == SPEED.layout.size:
            (self.velocity,) = SPEED.layout.unpack(data)
            self._received.add(SPEED.number)

    def _on_emergency(self, can_id: int, data: Any, timestamp: float) -> None:
        if len(data) >= 2:
            self.emergency = int.from_bytes(data[:2], "little")
            self.emergencies += self.emergency != 0

    def _on_heartbeat(self, can_id: int, data: Any, timestamp: float) -> None:
        self.cycles_since_heartbeat = 0

    def send(self, command: Command, raw_torque: int) -> None:
        """Send the RPDO with controlword and target torque [0.001 rated torque]."""
        self._network.send_message(
            TARGET.base + self.node_id, TARGET.layout.pack(command.value, raw_torque)
        )

    @property
    def status_text(self) -> str:
        """Text with the state, the statusword and the last emergency of the drive, for messages."""
        state = "an undefined state" if self.state is None else f"the state {self.state.value}"
        emergency = f", EMCY {objects.error_text(self.emergency)}" if self.emergency else ""
        return f"{state} (statusword 0x{self.statusword:04X}{emergency})"

    @property
    def powered(self) -> bool:
        return self.state in POWERED


def _period(cycle: float) -> tuple[int, int]:
    """Return a period [s] as a value and a power of ten, for the object 60C2h.

    Raises DeviceError if the value does not fit into one byte.
    """
    for index in (-3, -4, -5, -6):
        value = cycle / 10.0**index
        if abs(value - round(value)) < 1e-6 and 1 <= round(value) <= 255:
            return round(value), index
    raise DeviceError(
        f"a cycle of {cycle:g} s cannot be written into the interpolation time period (60C2h): 1 to 255 times a power of ten is expected"
    )
