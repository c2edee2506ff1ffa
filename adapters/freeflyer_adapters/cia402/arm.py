"""Device driver of an arm with one CiA 402 drive per joint, in cyclic synchronous torque mode.

In CANopen, no single frame contains the state of the whole arm. Therefore no frame can be the clock
of the loop, and the loop waits for absolute deadlines (`is_clock = False`). The host is the
producer of SYNC: the CANopen frame at which the drives latch their measurements and apply targets.

In each cycle, `read` first sends SYNC, before any computation. Therefore the jitter of SYNC is only
the jitter of the host's wake-up. Then `read` waits for the TPDOs of all drives. `write` sends the
target torques. The drives apply these targets at the next SYNC.

Terms in this file:

- RPDO, TPDO: cyclic frame that a drive receives, and cyclic frame that a drive sends.
- SDO: request and response that read or write one object of a drive.
- NMT: CANopen service that changes a node between the states pre-operational and operational.
- EMCY, emergency: frame that a drive sends when an error occurs.
- Permit: object that decides whether the host may send frames that give power to the drives
  (`permit.py`).
- Controller: a host that sends SYNC and targets on the bus.
- Graded stop: the torque decreases to zero, then a quick stop disables the drives. The brakes of
  disabled drives are engaged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from freeflyer.fmi.component import Array, Port, memory
from freeflyer_adapters.can.link import flush, open_bus
from freeflyer_adapters.cia402 import load, objects, process_data
from freeflyer_adapters.cia402.network import PolledNetwork
from freeflyer_adapters.cia402.options import DriveOptions
from freeflyer_adapters.cia402.parameters import DRIVES
from freeflyer_adapters.cia402.remote_drive import HEARTBEATS_MISSED, RemoteDrive
from freeflyer_adapters.cia402.scaling import Scaling
from freeflyer_adapters.cia402.state_machine import Command, DriveState
from freeflyer_adapters.device import parameters as device_parameters
from freeflyer_adapters.device.device import LifeCycle, SafeStop, State
from freeflyer_adapters.device.limits import ArmLimits
from freeflyer_adapters.device.permit import Permit
from freeflyer_adapters.device.quality import QualityMonitor
from freeflyer_adapters.device.ramp_down import RampDown
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.foundation.histogram import Histogram
from freeflyer_adapters.foundation.pacing import Pacer

ANSWER_SHARE = 0.6
"""Part of the cycle in which the TPDOs must arrive.

The rest of the cycle is for the controllers and for sending the targets.
"""
LISTEN = 0.1
"""Shortest time [s] of reception before the first transmission, to detect another controller."""
BRAKE_TIMEOUT = 4.0
"""Longest duration of the graded stop, as a multiple of the ramp-down time.

After this time, the host no longer waits for the brakes. Then only the watchdogs of the drives can
engage the brakes.
"""
STOP_SDO_TIMEOUT = 0.05
"""Timeout for an SDO response during a graded stop [s]."""
FOREIGN_FRAMES = "SYNC, targets, or the host's heartbeat"
OPERATIONAL = b"\x05"
"""Data of a heartbeat in the NMT state operational."""


class Cia402Arm:
    """Host side of the drives. Implements `freeflyer_adapters.device.device.Device`."""

    is_clock = False

    def __init__(self, name: str, options: DriveOptions) -> None:
        self.name, self.options = name, options
        self.state = State(name)
        self._environment = environment.present()
        n = options.joints
        self.ports: Mapping[str, Port] = device_parameters.arm_ports(n, DRIVES)
        self.values = memory(self.ports.values())
        self.scaling = Scaling(options.motors)
        self.answers, self.targets = Histogram(), Histogram()
        self.drives: list[RemoteDrive] = []
        self.bus_load = 0.0
        self.commands_sent = 0
        self._network: PolledNetwork | None = None
        self.permit = self._new_permit()
        self._last_torque = np.zeros(n)
        self._stopping_torque: Array | None = None
        self._is_prepared = False
        """Whether the drives are in the NMT state operational.

        Drives process PDOs only in this state.
        """
        self._powered = False
        """Whether a controlword may have switched a drive on."""
        self._is_enabling = False
        self._targets_due = False
        self._synced = 0
        self._cycles = 0
        self._silent = np.zeros(n, dtype=int)
        self._has_position = np.zeros(n, dtype=bool)
        """For each joint, whether an earlier position is known.

        An earlier position is needed to estimate a speed.
        """
        self._foreign_frames = 0
        self._failed = 0
        self._is_host = False
        """Whether the host sends SYNC in every cycle. The host then also sends its heartbeats."""

    @property
    def woken(self) -> int:
        return 0

    @property
    def step(self) -> float:
        return float(self.values["period"][0])

    def _new_permit(self) -> Permit:
        v = self.values
        return Permit(
            "the arm", watchdog=round(float(v["watchdog_cycles"][0] * v["period"][0]) * 1e9)
        )

    remarks = ()

    @property
    def may_have_power(self) -> bool:
        return self._powered and self._network is not None

    @property
    def cannot_refuse(self) -> list[str]:
        """Sentences for the user about what CiA 402 drives cannot reject by themselves."""
        return [
            "CiA 402 has no session number: a drive in the NMT state operational accepts the controlwords of any controller; between runs, "
            "the drives are in the NMT state pre-operational and ignore PDOs"
        ]

    @property
    def _where(self) -> str:
        return f"{self.name} on CAN {self.options.interface}:{self.options.channel}"

    # Before the activation

    def configure(self) -> None:
        # Check settings and bus load, and derive the limits.
        o, v = self.options, self.values
        device_parameters.check(self.name, DRIVES, v)
        self.cycle = self.step
        self.bus_load = load.check(
            self.name,
            o.joints,
            self.cycle,
            o.bitrate,
            o.heartbeat,
            o.largest_load,
            measured_velocity=o.measured_velocity,
        )
        self.limits = ArmLimits(v, self.cycle)
        self.monitor = QualityMonitor.of(f"TPDOs of {self.name}", v, self.cycle)
        self.ramp = RampDown.of(v)
        objects.dictionary(o.eds, o.node_ids[0])  # report errors in the EDS before opening the bus
        # Open the bus, and check for another controller before the first transmission.
        timeout = float(v["configure_timeout"][0])
        self._network = PolledNetwork(
            open_bus(o.interface, o.channel, False, [], {"bitrate": int(o.bitrate), **o.bus})
        )
        self._network.subscribe(process_data.SYNC, self._on_foreign_frame)
        self._network.subscribe(process_data.HEARTBEAT + o.host_node_id, self._on_foreign_frame)
        self._listen()
        # Identify the drives by SDO, compare them with the scenario, and read the measurements.
        self.permit = permit = self._new_permit()
        self.drives = [
            RemoteDrive(self.name, joint, node, o, self._network, timeout, permit)
            for joint, node in enumerate(o.node_ids)
        ]
        for node in o.node_ids:
            self._network.subscribe(process_data.TARGET.base + node, self._on_foreign_frame)
        for drive in self.drives:
            drive.identify()
        for drive, effort in zip(self.drives, v["joint_effort_limit"], strict=True):
            drive.compare(float(effort))
        self._measure()
        self.state.to(LifeCycle.inactive)

    def _measure(self) -> None:
        """Read the measurements of all drives by SDO. This changes no object of a drive."""
        for drive in self.drives:
            drive.measure()
        self._take()

    def _listen(self) -> None:
        """Receive without sending. Raises DeviceError if another controller is on the bus."""
        assert self._network is not None
        end = self._environment.monotonic() + max(
            LISTEN, 3 * self.cycle, 1.5 * self.options.heartbeat
        )
        while (left := end - self._environment.monotonic()) > 0.0:
            self._network.poll(left)
            self._check_single_controller()

    def _on_foreign_frame(self, can_id: int, data: object, timestamp: float) -> None:
        """Count a frame of another controller.

        Precondition: the CAN interface does not return the frames that this host has sent.
        """
        self._foreign_frames += 1

    def _check_single_controller(self) -> None:
        if self._foreign_frames:
            raise DeviceError(
                f"{self._where}: another controller sends {FOREIGN_FRAMES} (node {self.options.host_node_id}) on this bus; stop the other "
                f"controller first"
            )

    def _first_measurement(self) -> None:
        """Send SYNC until all drives respond.

        Raises DeviceError if a drive does not respond within `configure_timeout`.
        """
        end = self._environment.monotonic() + float(self.values["configure_timeout"][0])
        while True:
            self._exchange(max(ANSWER_SHARE * self.cycle, 0.05))
            self._check_single_controller()
            silent = [drive for drive in self.drives if not drive.fresh]
            if not silent:
                return
            if self._environment.monotonic() > end:
                raise DeviceError(
                    f"{silent[0].where} does not answer SYNC with its TPDOs; are the PDOs mapped, and is the drive operational?"
                )

    def stay(self) -> None:
        """Send SYNC and targets while other devices are activated.

        Without SYNC, the watchdogs would stop enabled drives. SYNC also shows other hosts that this
        host uses the bus.
        """
        is_held_up = self.permit.hold_up(self._environment.monotonic_ns())
        is_idle = self._is_prepared and not self._is_enabling and not is_held_up
        if self._network is not None and is_idle:
            self._is_host = True
            self._exchange(0.0)
            self._send_targets(self._last_torque)

    def check_start(self) -> None:
        assert self._network is not None
        self._network.drain()
        self._check_single_controller()
        self._measure()
        if reason := self.limits.start(self.values):
            raise DeviceError(f"{self._where}: {reason}")

    def prepare(self) -> None:
        """Configure every drive, reset faults, then change to the NMT state operational.

        The drives stay in the state Switch on disabled. Raises DeviceError if a drive does not
        respond, rejects its configuration, or remains in the state Fault.
        """
        for drive in self.drives:
            drive.set_up(self.cycle)
        for drive in self.drives:
            drive.reset_fault()
        self._is_prepared = True
        for drive in self.drives:
            drive.node.nmt.state = "OPERATIONAL"
        self._first_measurement()

    def activate(self, meanwhile: Callable[[], bool]) -> None:
        """Enable all drives.

        The first target torques are zero, like the torques of the drives while the joints are
        braked. Target torques do not include the torques that carry the weight of the arm.
        """
        self._last_torque = np.zeros(self.options.joints)
        self.scaling.reset()
        # The first heartbeat of the host starts the heartbeat monitors of the drives. After this
        # heartbeat, no heartbeat may be missing. From now on, the cycles of the host are not
        # interrupted. Therefore `_cycles = 0` makes the next cycle send a heartbeat.
        self._is_host, self._cycles = True, 0
        for drive in self.drives:
            drive.emergency = 0
        self.permit.take(self._environment.monotonic_ns())
        self._powered = True
        if not self._enable(meanwhile):
            return  # the user stops the run before its first cycle; `deactivate` disables drives
        self._silent[:] = 0
        self._send_targets(self._last_torque)
        self.state.to(LifeCycle.active)

    def revoke(self, reason: str) -> None:
        """Revoke the permit. From now on, only frames of the graded stop are sent."""
        self.permit.lose(reason)
        flush(None if self._network is None else self._network.bus)

    def _enable(self, meanwhile: Callable[[], bool]) -> bool:
        """Command one state transition per cycle, until all drives are in Operation enabled.

        Return False if the user requests a stop. Raises DeviceError if a drive does not reach the
        state Operation enabled. The message names the drive.
        """
        zero = np.zeros(self.options.joints)
        pacer = Pacer(round(self.cycle * 1e9))
        end = self._environment.monotonic() + float(self.values["configure_timeout"][0])
        self._is_enabling = True
        try:
            while not all(drive.state is DriveState.operation_enabled for drive in self.drives):
                self._send_targets(zero)
                pacer.wait()
                # The drives apply the targets at SYNC. Do not send SYNC after a delay of the loop,
                # because the targets are too old after the delay.
                if self.permit.allows(self._environment.monotonic_ns()):
                    self._exchange(ANSWER_SHARE * self.cycle)
                self._check_single_controller()
                if meanwhile():
                    return False
                if self._environment.monotonic() > end or self.permit.lost:
                    late = next(
                        (d for d in self.drives if d.state is not DriveState.operation_enabled),
                        self.drives[0],
                    )
                    why = f": {self.permit.lost}" if self.permit.lost else late.error_code
                    raise DeviceError(
                        f"{late.where} does not reach the state {DriveState.operation_enabled.value}: it is in {late.status_text}{why}"
                    )
            return True
        finally:
            self._is_enabling = False

    # In every cycle

    def read(self) -> None:
        # Check for a delay of the loop first, because a delay causes the errors that follow.
        self._stop_if_held_up()
        self._exchange(ANSWER_SHARE * self.cycle)
        self._stop_if_held_up()
        self._targets_due = True
        # Stop if too many cycles were lost, or if a measurement is too old.
        silent = [drive for drive in self.drives if not drive.fresh]
        reason = self.monitor.observe(lost=bool(silent))
        if reason:
            error = self._network.error if self._network is not None else ""
            raise SafeStop(
                self.name,
                f"{reason}; no TPDO from {', '.join(f'node {d.node_id}' for d in silent)}"
                + (f" (the interface reported: {error})" if error else ""),
            )
        oldest = int(np.argmax(self._silent))
        if self._silent[oldest] * self.cycle > float(self.values["state_age_limit"][0]):
            raise SafeStop(
                self.name,
                f"the last TPDO of joint {oldest + 1} is {self._silent[oldest] * self.cycle:.4g} s old, its limit is "
                f"{float(self.values['state_age_limit'][0]):g} s",
            )
        # Stop if a drive is not enabled, has sent an emergency, or sends no heartbeats.
        for drive in self.drives:
            if drive.state is not DriveState.operation_enabled:
                raise SafeStop(
                    self.name,
                    f"{drive.label} left the state Operation enabled by itself: it is in {drive.status_text}",
                )
            if drive.emergency:
                raise SafeStop(
                    self.name, f"{drive.label} sent an emergency: it is in {drive.status_text}"
                )
            if (
                drive.cycles_since_heartbeat * self.cycle
                > HEARTBEATS_MISSED * self.options.heartbeat
            ):
                raise SafeStop(
                    self.name,
                    f"{drive.label} has sent no heartbeat for {drive.cycles_since_heartbeat * self.cycle:.3g} s; a heartbeat every "
                    f"{self.options.heartbeat:g} s is expected",
                )
        # Stop if there is a second controller, or if a measured position or speed exceeds its
        # limit.
        if self._foreign_frames:
            raise SafeStop(self.name, f"another controller sends {FOREIGN_FRAMES} on this bus")
        reason = self.limits.measured(self.values["joint_position"], self.values["joint_velocity"])
        if reason:
            raise SafeStop(self.name, reason)

    def _stop_if_held_up(self) -> None:
        if sentence := self.permit.hold_up(self._environment.monotonic_ns()):
            raise SafeStop(self.name, sentence)

    def _exchange(self, timeout: float) -> None:
        """Send one SYNC, then receive until all drives have responded.

        The reception takes at most `timeout` [s].
        """
        network = self._network
        assert network is not None
        network.drain()  # pending TPDOs are responses to an earlier SYNC
        for drive in self.drives:
            drive.expect()
        network.sync.transmit()
        self._synced = self._environment.monotonic_ns()
        every = max(1, round(self.options.heartbeat / self.cycle))
        if self._is_host and self._cycles % every == 0:
            network.send_message(process_data.HEARTBEAT + self.options.host_node_id, OPERATIONAL)
        self._cycles += 1
        # Receive until the TPDOs of all drives are complete.
        end = self._synced * 1e-9 + timeout
        missing = list(self.drives)
        while missing:
            left = end - self._environment.monotonic()
            if not network.poll(max(left, 0.0)) and left <= 0.0:
                break
            missing = [drive for drive in missing if not drive.fresh]
        if not missing and self.state.now is LifeCycle.active:
            self.answers.add(self._environment.monotonic_ns() - self._synced)
        if not missing:
            # The permit needs a time that is not later than the states in these TPDOs. The drives
            # sent the TPDOs after this SYNC. Therefore use the time of SYNC.
            self.permit.report(
                all(d.state is DriveState.operation_enabled for d in self.drives), self._synced
            )
        self._take()

    def _take(self) -> None:
        """Convert the raw numbers of the drives to measurements in SI units.

        A joint without a new TPDO keeps its last measurement.
        """
        v, s = self.values, self.scaling
        fresh = np.array([drive.fresh for drive in self.drives])
        cycles = self._silent + 1
        position = np.array([drive.position for drive in self.drives]) * s.position_step
        if self.options.measured_velocity:
            v["joint_velocity"][:] = (
                np.array([drive.velocity for drive in self.drives]) * s.velocity_step
            )
        else:
            moved = (position - v["joint_position"]) / (cycles * self.cycle)
            has_speed = fresh & self._has_position
            v["joint_velocity"][has_speed] = moved[has_speed]
        self._has_position |= fresh
        v["joint_position"][fresh] = position[fresh]
        v["joint_torque"][:] = np.array([drive.torque for drive in self.drives]) * s.torque_step
        self._silent = np.where(fresh, 0, cycles)

    def write(self) -> None:
        if not self._targets_due:  # send one target per SYNC
            return
        torque, reason = self.limits.command(self.values["joint_torque_command"], self._last_torque)
        if reason is None and not self.permit.allows(self._environment.monotonic_ns()):
            reason = self.permit.lost or "it has not been activated"
        if reason:
            raise SafeStop(self.name, reason)
        self._send_targets(torque)
        self.targets.add(self._environment.monotonic_ns() - self._synced)
        self._targets_due = False
        self._last_torque = torque

    def _send_targets(self, torque: Array, *, brake: bool = False) -> None:
        """Send one RPDO to every drive, with the command that the session of the drive allows now.

        Each drive has a session (`drive_session.py`). If the sessions of all drives allow the
        command "enable operation", the target torques are `torque`. Otherwise all target torques
        are zero. `brake`: whether the drives must stop now.
        """
        now = self._environment.monotonic_ns()
        commands = [drive.session.answer(now, brake=brake) for drive in self.drives]
        if not all(command is Command.enable_operation for command in commands):
            torque = np.zeros_like(torque)
        for drive, command, raw in zip(
            self.drives, commands, self.scaling.raw_torque(torque).tolist(), strict=True
        ):
            drive.send(command, int(raw))
        self.permit.wrote(now)
        self.commands_sent += 1

    # During and after a stop

    def ramp_down(self, elapsed: float) -> bool:
        if self._network is None or not self._powered:
            return True
        if self._stopping_torque is None:
            self._stopping_torque = self._last_torque.copy()
        if self.permit.hold_up(self._environment.monotonic_ns()):
            # Do not send SYNC, because the drives would then apply the targets from before the
            # delay. The watchdogs have already stopped the drives.
            for drive in self.drives:
                drive.node.sdo.RESPONSE_TIMEOUT = STOP_SDO_TIMEOUT
            self._measure()
            return self.at_rest or elapsed > BRAKE_TIMEOUT * self.ramp.time
        self._exchange(ANSWER_SHARE * self.cycle)
        velocity = self.values["joint_velocity"]
        if self.ramp.over(velocity, elapsed) or self.state.now is not LifeCycle.active:
            self._brake()
            return self.at_rest or elapsed > BRAKE_TIMEOUT * self.ramp.time
        wanted = self.ramp.torque(self._stopping_torque, velocity, elapsed)
        self._last_torque, _ = self.limits.command(wanted, self._last_torque)
        self._send_targets(self._last_torque)
        return False

    @property
    def at_rest(self) -> bool:
        """Whether all drives have reported, in the last cycle, a state without torque.

        In these states, the brakes are engaged.
        """
        return bool(self.drives) and all(
            drive.state is not None and not drive.powered and not silent
            for drive, silent in zip(self.drives, self._silent, strict=True)
        )

    def on_error(self, reason: str) -> None:
        if self.state.now is LifeCycle.active:
            self._stop_now()
            self.state.to(LifeCycle.safe_stop)

    def deactivate(self) -> None:
        if self._network is None:
            return
        if self._powered:  # also after an incomplete activation
            self._stop_now()
        # In the NMT state pre-operational, the drives ignore the PDOs of every controller.
        if self._is_prepared:
            for drive in self.drives:
                drive.node.nmt.state = "PRE-OPERATIONAL"
        self._is_prepared = False
        if self.state.now in (LifeCycle.active, LifeCycle.safe_stop):
            self.state.to(LifeCycle.inactive)
        self._network.disconnect()
        self._failed = self._network.failed
        self._network = None

    def _brake(self) -> None:
        """Command a quick stop: the drives ramp down, disable power and engage their brakes."""
        self._last_torque = np.zeros(self.options.joints)
        self.scaling.reset()
        self._send_targets(self._last_torque, brake=True)

    def _stop_now(self) -> None:
        if self._network is not None and self.drives:
            is_held_up = self.permit.hold_up(self._environment.monotonic_ns())
            self._brake()
            if not is_held_up:
                self._network.sync.transmit()  # the drives apply the targets at SYNC

    def report(self) -> Mapping[str, float]:
        counts = {
            "tpdos_accepted": sum(drive.accepted for drive in self.drives),
            "cycles_lost": self.monitor.lost,
            "longest_loss_cycles": self.monitor.longest_row,
            "cycles_with_targets_sent": self.commands_sent,
            "frames_not_taken_by_the_interface": self._failed
            if self._network is None
            else self._network.failed,
            "emergencies": sum(drive.emergencies for drive in self.drives),
            "bus_load_percent": round(100 * self.bus_load),
        }
        return {name: float(count) for name, count in {**counts, **self.limits.report()}.items()}

    def histograms(self) -> Mapping[str, Histogram]:
        return {
            f"{self.name}: all drives' answers after SYNC": self.answers,
            f"{self.name}: targets sent after SYNC": self.targets,
        }
