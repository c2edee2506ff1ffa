"""An arm of CiA 402 drives, one a joint, in cyclic synchronous torque mode, as one device.

CANopen has no frame of the whole arm that could be the clock: the host is it, as the producer of SYNC, and the loop is paced by
absolute deadlines (`is_clock = False`). A cycle: `read` sends SYNC at once, so that its jitter is that of waking up and nothing else,
and waits for the TPDOs that every drive answers with; `write` sends the targets, which the drives apply at the next SYNC.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from freeflyer.fmi.component import Array, Port, memory
from freeflyer_adapters.can.link import flush, open_bus
from freeflyer_adapters.cia402 import load, objects, process_data
from freeflyer_adapters.cia402.network import PolledNetwork
from freeflyer_adapters.cia402.options import DriveOptions
from freeflyer_adapters.cia402.remote_drive import HEARTBEATS_MISSED, RemoteDrive
from freeflyer_adapters.cia402.scaling import Scaling
from freeflyer_adapters.cia402.settings import DRIVES
from freeflyer_adapters.cia402.state_machine import Command, DriveState
from freeflyer_adapters.device import settings as all_settings
from freeflyer_adapters.device.device import DeviceError, LifeCycle, SafeStop, State
from freeflyer_adapters.device.limits import ArmLimits
from freeflyer_adapters.device.permit import Permit
from freeflyer_adapters.device.quality import QualityMonitor
from freeflyer_adapters.device.ramp_down import RampDown
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.histogram import Histogram
from freeflyer_adapters.foundation.pacing import Pacer

ANSWER_SHARE = 0.6
"""Share of the cycle in which the TPDOs of a SYNC must have come; the rest is for controllers and targets."""
LISTEN = 0.1
"""Before it sends anything, the host listens so long [s], and three cycles, for another SYNC producer."""
GIVE_UP = 4.0
"""Drives that have not confirmed their brakes after so many ramp-down times are left to their own watchdogs."""
SHORT = 0.05
"""[s] for an answer by SDO in the graded stop."""
OTHERS = "SYNC, targets, or the host's heartbeat"
OPERATIONAL = b"\x05"
"""NMT state in a heartbeat."""


class Cia402Arm:
    """See `freeflyer_adapters.device.device.Device` for the calls."""

    is_clock = False

    def __init__(self, name: str, options: DriveOptions) -> None:
        self.name, self.options = name, options
        self.state = State(name)
        self._environment = environment.present()
        n = options.joints
        self.ports: Mapping[str, Port] = all_settings.arm_ports(n, DRIVES)
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
        """Whether the drives process PDOs."""
        self._powered = False
        """Whether a controlword may have switched a drive on."""
        self._walking = False
        self._targets_due = False
        self._synced = 0
        self._cycles = 0
        self._silent = np.zeros(n, dtype=int)
        self._known = np.zeros(n, dtype=bool)
        """Whose position was heard, so that a difference is a speed."""
        self._strange_syncs = 0
        self._failed = 0
        self._is_host = False
        """Whether SYNC goes out in every cycle, and with it the host's heartbeat."""

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
        """What drives of this profile cannot refuse by themselves, a sentence for each."""
        return [
            "CiA 402 has no session number: a drive in NMT state operational follows any controller's controlwords; between runs NMT "
            "state pre-operational keeps them out"
        ]

    @property
    def _where(self) -> str:
        return f"{self.name} on CAN {self.options.interface}:{self.options.channel}"

    # Before anything moves

    def configure(self) -> None:
        o, v = self.options, self.values
        all_settings.check(self.name, DRIVES, v)
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
        self.monitor = QualityMonitor(
            f"TPDOs of {self.name}",
            consecutive=int(v["lost_consecutive"][0]),
            within=int(v["lost_in_window"][0]),
            window=round(float(v["window"][0]) / self.cycle),
            cycle=self.cycle,
        )
        self.ramp = RampDown(
            time=float(v["ramp_down_time"][0]), damping=float(v["ramp_down_damping"][0])
        )
        objects.dictionary(o.eds, o.node_ids[0])  # its mistakes are told before anything is opened
        patience = float(v["configure_timeout"][0])
        self._network = PolledNetwork(
            open_bus(o.interface, o.channel, False, [], {"bitrate": int(o.bitrate), **o.bus})
        )
        self._network.subscribe(process_data.SYNC, self._on_strange_sync)
        self._network.subscribe(process_data.HEARTBEAT + o.host_node_id, self._on_strange_sync)
        self._listen()
        self.permit = permit = self._new_permit()
        self.drives = [
            RemoteDrive(self.name, joint, node, o, self._network, patience, permit)
            for joint, node in enumerate(o.node_ids)
        ]
        for node in o.node_ids:
            self._network.subscribe(process_data.TARGET.base + node, self._on_strange_sync)
        for drive in self.drives:
            drive.identify()
        for drive, effort in zip(self.drives, v["joint_effort_limit"], strict=True):
            drive.compare(float(effort))
        self._measure()
        self.state.to(LifeCycle.inactive)

    def _measure(self) -> None:
        """By SDO: the drives stay as they are."""
        for drive in self.drives:
            drive.measure()
        self._take()

    def _listen(self) -> None:
        """A bus has one SYNC producer. CANopen has no other word for a second controller."""
        assert self._network is not None
        end = self._environment.monotonic() + max(
            LISTEN, 3 * self.cycle, 1.5 * self.options.heartbeat
        )
        while (left := end - self._environment.monotonic()) > 0.0:
            self._network.poll(left)
            self._refuse_another_controller()

    def _on_strange_sync(self, can_id: int, data: object, timestamp: float) -> None:
        """An interface does not give back what it has sent itself."""
        self._strange_syncs += 1

    def _refuse_another_controller(self) -> None:
        if self._strange_syncs:
            raise DeviceError(
                f"{self._where}: another controller sends {OTHERS} (node {self.options.host_node_id}), on this bus; stop that one first"
            )

    def _first_measurement(self) -> None:
        end = self._environment.monotonic() + float(self.values["configure_timeout"][0])
        while True:
            self._exchange(max(ANSWER_SHARE * self.cycle, 0.05))
            self._refuse_another_controller()
            silent = [drive for drive in self.drives if not drive.fresh]
            if not silent:
                return
            if self._environment.monotonic() > end:
                raise DeviceError(
                    f"{silent[0].where} does not answer SYNC with its TPDOs; are its PDOs mapped, and is it operational?"
                )

    def stay(self) -> None:
        """While other devices take their time: SYNC tells everybody that the bus has its host, and keeps enabled drives from stopping."""
        is_held_up = self.permit.hold_up(self._environment.monotonic_ns())
        if self._network is not None and self._is_prepared and not self._walking and not is_held_up:
            self._is_host = True
            self._exchange(0.0)
            self._send_targets(self._last_torque)

    def check_start(self) -> None:
        assert self._network is not None
        self._network.drain()
        self._refuse_another_controller()
        self._measure()
        gap = np.abs(self.values["joint_position"] - self.values["start_joint_position"])
        tolerance = float(self.values["start_tolerance"][0])
        if not (gap <= tolerance).all():
            j = int(np.argmax(gap))
            raise DeviceError(
                f"{self._where}: joint {j + 1} is at {self.values['joint_position'][j]:.4f} rad, the scenario starts at "
                f"{self.values['start_joint_position'][j]:.4f} rad, and {tolerance:g} rad is the largest distance allowed: move the arm there"
            )

    def prepare(self) -> None:
        """Mode, heartbeats and PDOs of every drive, a fault's reset, then NMT start. The drives rest in Switch on disabled."""
        for drive in self.drives:
            drive.set_up(self.cycle)
        for drive in self.drives:
            drive.reset_fault()
        self._is_prepared = True
        for drive in self.drives:
            drive.node.nmt.state = "OPERATIONAL"
        self._first_measurement()

    def activate(self, meanwhile: Callable[[], bool]) -> None:
        """Every drive to Operation enabled, with zero torque beyond gravity, which is what braked joints hold."""
        self._last_torque = np.zeros(self.options.joints)
        self.scaling.forget()
        # From the first one on the drives watch the host's heartbeat, so it begins with the cycles that do not cease any more.
        self._is_host, self._cycles = True, 0
        for drive in self.drives:
            drive.emergency = 0
        self.permit.take(self._environment.monotonic_ns())
        self._powered = True
        if not self._walk(meanwhile):
            return  # the loop ends before its first instant, and the stop switches off
        self._silent[:] = 0
        self._send_targets(self._last_torque)
        self.state.to(LifeCycle.active)

    def revoke(self, reason: str) -> None:
        """A reason to stop: from now on only what lowers is sent."""
        self.permit.lose(reason)
        flush(None if self._network is None else self._network.bus)

    def _walk(self, meanwhile: Callable[[], bool]) -> bool:
        """One step of every drive's state machine in every cycle, until all are enabled; False if the user stops it. DeviceError names the
        drive that is not.
        """
        zero = np.zeros(self.options.joints)
        pacer = Pacer(round(self.cycle * 1e9))
        end = self._environment.monotonic() + float(self.values["configure_timeout"][0])
        self._walking = True
        try:
            while not all(drive.state is DriveState.operation_enabled for drive in self.drives):
                self._send_targets(zero)
                pacer.wait()
                # The targets act with the next SYNC, which must not come once they are old.
                if self.permit.allows(self._environment.monotonic_ns()):
                    self._exchange(ANSWER_SHARE * self.cycle)
                self._refuse_another_controller()
                if meanwhile():
                    return False
                if self._environment.monotonic() > end or self.permit.lost:
                    late = next(
                        (d for d in self.drives if d.state is not DriveState.operation_enabled),
                        self.drives[0],
                    )
                    why = f": {self.permit.lost}" if self.permit.lost else late.error_code
                    raise DeviceError(
                        f"{late.where} does not come to {DriveState.operation_enabled.value}: it is in {late.says}{why}"
                    )
            return True
        finally:
            self._walking = False

    # Every cycle

    def read(self) -> None:
        self._stop_if_held_up()
        self._exchange(ANSWER_SHARE * self.cycle)
        self._stop_if_held_up()  # also while it waited: the cause comes before its effects
        self._targets_due = True
        silent = [drive for drive in self.drives if not drive.fresh]
        reason = self.monitor.observe(lost=bool(silent))
        if reason:
            error = self._network.error if self._network is not None else ""
            raise SafeStop(
                self.name,
                f"{reason}; silent is {', '.join(f'node {d.node_id}' for d in silent)}"
                + (f" (the interface reported: {error})" if error else ""),
            )
        oldest = int(np.argmax(self._silent))
        if self._silent[oldest] * self.cycle > float(self.values["state_age_limit"][0]):
            raise SafeStop(
                self.name,
                f"the last TPDO of joint {oldest + 1} is {self._silent[oldest] * self.cycle:.4g} s old, its limit is "
                f"{float(self.values['state_age_limit'][0]):g} s",
            )
        for drive in self.drives:
            if drive.state is not DriveState.operation_enabled:
                raise SafeStop(
                    self.name,
                    f"{drive.who} left Operation enabled by itself: it is in {drive.says}",
                )
            if drive.emergency:
                raise SafeStop(self.name, f"{drive.who} sent an emergency: it is in {drive.says}")
            if (
                drive.cycles_since_heartbeat * self.cycle
                > HEARTBEATS_MISSED * self.options.heartbeat
            ):
                raise SafeStop(
                    self.name,
                    f"{drive.who} has sent no heartbeat for {drive.cycles_since_heartbeat * self.cycle:.3g} s; one every "
                    f"{self.options.heartbeat:g} s is expected",
                )
        if self._strange_syncs:
            raise SafeStop(self.name, f"another controller sends {OTHERS}, on this bus")
        reason = self.limits.measured(self.values["joint_position"], self.values["joint_velocity"])
        if reason:
            raise SafeStop(self.name, reason)

    def _stop_if_held_up(self) -> None:
        if sentence := self.permit.hold_up(self._environment.monotonic_ns()):
            raise SafeStop(self.name, sentence)

    def _exchange(self, timeout: float) -> None:
        """One SYNC, and what came until all drives have answered it, or `timeout` [s]."""
        network = self._network
        assert network is not None
        network.drain()  # what came late belongs to an older SYNC
        for drive in self.drives:
            drive.expect()
        network.sync.transmit()
        self._synced = self._environment.monotonic_ns()
        every = max(1, round(self.options.heartbeat / self.cycle))
        if self._is_host and self._cycles % every == 0:
            network.send_message(process_data.HEARTBEAT + self.options.host_node_id, OPERATIONAL)
        self._cycles += 1
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
            # They answer this SYNC, so they were made after it.
            self.permit.report(
                all(d.state is DriveState.operation_enabled for d in self.drives), self._synced
            )
        self._take()

    def _take(self) -> None:
        """Raw numbers to SI; a drive that was silent keeps what it said last."""
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
            known = fresh & self._known
            v["joint_velocity"][known] = moved[known]
        self._known |= fresh
        v["joint_position"][fresh] = position[fresh]
        v["joint_torque"][:] = np.array([drive.torque for drive in self.drives]) * s.torque_step
        self._silent = np.where(fresh, 0, cycles)

    def write(self) -> None:
        if not self._targets_due:  # one target for each SYNC
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
        """One target to every drive, with the command that its session allows now."""
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

    # The end

    def ramp_down(self, elapsed: float) -> bool:
        if self._network is None or not self._powered:
            return True
        if self._stopping_torque is None:
            self._stopping_torque = self._last_torque.copy()
        if self.permit.hold_up(self._environment.monotonic_ns()):
            # No SYNC any more: targets from before the hold-up wait in the drives for it. They have stopped by themselves.
            for drive in self.drives:
                drive.node.sdo.RESPONSE_TIMEOUT = SHORT
            self._measure()
            return self.at_rest or elapsed > GIVE_UP * self.ramp.time
        self._exchange(ANSWER_SHARE * self.cycle)
        velocity = self.values["joint_velocity"]
        if self.ramp.over(velocity, elapsed) or self.state.now is not LifeCycle.active:
            self._brake()
            return self.at_rest or elapsed > GIVE_UP * self.ramp.time
        wanted = self.ramp.torque(self._stopping_torque, velocity, elapsed)
        self._last_torque, _ = self.limits.command(wanted, self._last_torque)
        self._send_targets(self._last_torque)
        return False

    @property
    def at_rest(self) -> bool:
        """The drives' own words: the drive function is off, which engages the brakes."""
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
        if self._powered:  # also where activation was given up half-way
            self._stop_now()
        if self._is_prepared:  # in this state no PDO is processed, whichever controller sends it
            for drive in self.drives:
                drive.node.nmt.state = "PRE-OPERATIONAL"
        self._is_prepared = False
        if self.state.now in (LifeCycle.active, LifeCycle.safe_stop):
            self.state.to(LifeCycle.inactive)
        self._network.disconnect()
        self._failed = self._network.failed
        self._network = None

    def _brake(self) -> None:
        """Quick stop: from Operation enabled each drive ramps down by itself, switches its power off, and its brake holds."""
        self._last_torque = np.zeros(self.options.joints)
        self.scaling.forget()
        self._send_targets(self._last_torque, brake=True)

    def _stop_now(self) -> None:
        if self._network is not None and self.drives:
            is_held_up = self.permit.hold_up(self._environment.monotonic_ns())
            self._brake()
            if not is_held_up:
                self._network.sync.transmit()  # targets act with the next SYNC

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
        acted = {f"{name}_acted": count for name, count in self.limits.acted.items()}
        return {name: float(count) for name, count in {**counts, **acted}.items()}

    def histograms(self) -> Mapping[str, Histogram]:
        return {
            f"{self.name}: all drives' answers after SYNC": self.answers,
            f"{self.name}: targets sent after SYNC": self.targets,
        }
