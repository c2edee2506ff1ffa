"""The arm on CAN as a device: its state frame is the clock, and every state frame is answered with one command."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping

import can
import numpy as np

from freeflyer.fmi.component import Array, Port, memory
from freeflyer_adapters.arm.description import compare
from freeflyer_adapters.arm.frames import ArmFrames, Mode
from freeflyer_adapters.arm.options import ArmOptions
from freeflyer_adapters.arm.session import STOPPED, ArmSession, Phase
from freeflyer_adapters.arm.state_frames import Numbers, StateFrames
from freeflyer_adapters.can.link import Receiver, Sender, flush, open_bus
from freeflyer_adapters.can.second_sender import LISTEN
from freeflyer_adapters.device import settings as all_settings
from freeflyer_adapters.device.device import DeviceError, LifeCycle, SafeStop, State
from freeflyer_adapters.device.limits import ArmLimits
from freeflyer_adapters.device.permit import Permit
from freeflyer_adapters.device.quality import QualityMonitor
from freeflyer_adapters.device.ramp_down import RampDown
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.histogram import Histogram

MEASURED = ("joint_position", "joint_velocity", "joint_torque")
GIVE_UP = 4.0
"""An arm that has not confirmed its brakes after so many ramp-down times is left to its own watchdog."""
PATIENCE = 1.5
"""A state frame is lost when it has not come after so many cycles since the last one."""


class CanArm:
    """See `freeflyer_adapters.device.device.Device` for the calls."""

    is_clock = True

    def __init__(self, name: str, options: ArmOptions) -> None:
        self.name, self.options = name, options
        self.state = State(name)
        self._environment = environment.present()
        n = options.joints
        self.frames = ArmFrames(options.frames, n)
        self.ports: Mapping[str, Port] = all_settings.arm_ports(n, all_settings.ARM)
        self.values = memory(self.ports.values())
        self.implicit = options.implicit
        self.frames.check_activation(name, self.implicit)
        self._has_modes = "mode" in self.frames.command
        self.wake_up, self.answer = Histogram(), Histogram()
        self.late_commands = 0
        self.cycle = self.step
        self.session = self._new_session()
        self._bus: can.BusABC | None = None
        self._cycle_number = 0
        self._arrived = 0
        self._last_torque = np.zeros(n)
        self._stopping_torque: Array | None = None
        self._state_said = "a stop" if not self._reports_state else self.session.state.name
        self._command_age = 0.0
        self._answered = True
        self._silent_cycles = 0
        self._braked = False
        self._brake_sent = False
        self._released = False
        """Whether a command may have released the brakes."""

    def _new_session(self) -> ArmSession:
        state = self.frames.state
        permit = Permit(
            "the arm",
            watchdog=round(float(self.values["watchdog_cycles"][0]) * self.cycle * 1e9),
            reports_state="life_cycle" in state,
        )
        return ArmSession(
            permit,
            lambda: 1 + secrets.randbelow(self.frames.controllers),
            implicit=self.implicit,
            echoes="obeyed_controller" in state and "mode" in self.frames.command,
        )

    remarks = ()

    @property
    def may_have_power(self) -> bool:
        return self._released and self._bus is not None

    @property
    def cannot_refuse(self) -> list[str]:
        """What this arm cannot refuse or report by itself, a sentence for each."""
        return self.frames.cannot_refuse(self.implicit)

    @property
    def woken(self) -> int:
        return self._arrived

    @property
    def step(self) -> float:
        return float(self.values["period"][0])

    # Before anything moves

    def configure(self) -> None:
        v = self.values
        all_settings.check(self.name, all_settings.ARM, v)
        self.cycle = self.step
        self.limits = ArmLimits(v, self.cycle)
        self.monitor = QualityMonitor(
            f"state frames of {self.name}",
            consecutive=int(v["lost_consecutive"][0]),
            within=int(v["lost_in_window"][0]),
            window=round(float(v["window"][0]) / self.cycle),
            cycle=self.cycle,
        )
        self.ramp = RampDown(
            time=float(v["ramp_down_time"][0]), damping=float(v["ramp_down_damping"][0])
        )
        self._age_limit = float(v["state_age_limit"][0])
        effort = v["joint_effort_limit"]
        self.frames.check_ranges({
            "joint_torque_command": [(-e, e) for e in effort],
            "joint_torque": [(-e, e) for e in effort],
            "joint_position": list(zip(v["joint_lower_limit"], v["joint_upper_limit"], strict=True)),
            "joint_velocity": [(-w, w) for w in v["joint_velocity_limit"]],
        })  # fmt: skip
        o = self.options
        description = self.frames.description
        seen = [
            self.frames.state,
            self.frames.command,
            *([] if description is None else [description]),
        ]
        self._bus = open_bus(o.interface, o.channel, self.frames.is_fd, seen, o.bus)
        self._sender = Sender(self._bus, self.frames.command)
        self._states = StateFrames(self._bus, self.frames, self._sender, self._take)
        self.session = self._new_session()
        if description is not None:
            described = self._described(Receiver(description))
            compare(self._where, description, described, v, o.joints)
        self._observe(LISTEN)
        self.state.to(LifeCycle.inactive)

    @property
    def _where(self) -> str:
        return f"{self.name} on CAN {self.options.interface}:{self.options.channel}"

    def _described(self, receiver: Receiver) -> dict[str, list[float]]:
        """Waits for a description; an arm that is active for another controller sends none, but its state frames name it."""
        end = self._patience_ends()
        while (left := end - self._environment.monotonic()) > 0.0:
            message, _ = self._states.receive(left)
            if message is None:
                continue
            found = receiver.take(message)
            if found is not None:
                return found
            state = self._states.receiver.take(message)
            if state is not None:
                self._take(state, self._environment.monotonic_ns(), 0)
                self._refuse_others()
        raise DeviceError(self._silence("description", receiver))

    def _patience_ends(self) -> float:
        return self._environment.monotonic() + float(self.values["configure_timeout"][0])

    def _silence(self, what: str, receiver: Receiver) -> str:
        return f"{self._where} {self._states.silence(what, receiver, float(self.values['configure_timeout'][0]))}"

    def _observe(self, frames: int) -> None:
        """The newest of so many state frames; nothing is sent. DeviceError for silence, and for a second arm or controller."""
        end = self._patience_ends() + 2 * frames * self.cycle
        self._states.drain()
        for _ in range(frames):
            if not self._states.wait(end - self._environment.monotonic()):
                raise DeviceError(self._silence("state", self._states.receiver))
            self._refuse_others()

    def _refuse_others(self) -> None:
        session = self.session
        if self._states.problem:
            raise DeviceError(f"{self._where}: {self._states.problem}")
        if session.is_obeyed_elsewhere:
            raise DeviceError(
                f"{self._where} obeys controller {session.obeyed} already; this is controller {session.number}: stop that one first"
            )
        if (
            self._reports_state
            and session.state is LifeCycle.active
            and session.phase in (Phase.listening, Phase.claiming)
        ):
            raise DeviceError(
                f"{self._where} is active already, and this run has not activated it: stop its controller first"
            )

    @property
    def _reports_state(self) -> bool:
        return self.session.permit.reports_state

    def stay(self) -> None:
        """While other devices take their time: keeps the session, or an active arm's watchdog, from running out."""
        if self.session.phase is Phase.claiming or self.state.now is LifeCycle.active:
            self._states.wait(0.0)
            self._send(np.zeros(self.options.joints))

    def check_start(self) -> None:
        self._observe(1)
        gap = np.abs(self.values["joint_position"] - self.values["start_joint_position"])
        tolerance = float(self.values["start_tolerance"][0])
        if not (gap <= tolerance).all():
            j = int(np.argmax(gap))
            raise DeviceError(
                f"{self._where}: joint {j + 1} is at {self.values['joint_position'][j]:.4f} rad, the scenario starts at "
                f"{self.values['start_joint_position'][j]:.4f} rad, and {tolerance:g} rad is the largest distance allowed: move the arm there"
            )

    def prepare(self) -> None:
        """Claims a session number, which leads from safe stop or fault to inactive. The brakes stay engaged."""
        self.session = session = self._new_session()
        self._released, self._stopping_torque = False, None
        session.claim()
        end = self._patience_ends()
        has_come = False
        while not session.is_claimed:
            self._send(np.zeros(self.options.joints))
            has_come = (
                self._states.wait(min(2 * self.cycle, end - self._environment.monotonic()))
                or has_come
            )
            self._refuse_others()
            if self._environment.monotonic() > end:
                if not has_come:
                    raise DeviceError(self._silence("state", self._states.receiver))
                raise DeviceError(
                    f"{self._where} sends its state ({self._state_said}), but does not take this controller's commands: it obeys "
                    f"{session.obeyed or 'none'}{self._states.errors}"
                )

    def activate(self, meanwhile: Callable[[], bool]) -> None:
        """The arm stands braked; the first torque beyond gravity is none, which is what it holds now."""
        session = self.session
        self._states.drain()
        if session.permit.lost:
            raise DeviceError(f"{self._where} was not activated: {session.permit.lost}")
        session.activate(self._environment.monotonic_ns())
        self._last_torque = np.zeros(self.options.joints)
        end, silent = self._patience_ends(), 0
        while session.phase is not Phase.commanding:
            self._released = True
            self._send(self._last_torque)
            came = self._states.wait(min(2 * self.cycle, end - self._environment.monotonic()))
            # An arm that was not received for long may have become active, stopped and forgotten this session meanwhile.
            silent = 0 if came else silent + 1
            if 2 * silent * self.cycle > self._age_limit:
                session.permit.lose(self._silence("state", self._states.receiver))
            if session.permit.lost:
                raise DeviceError(f"{self._where} was not activated: {session.permit.lost}")
            if self._environment.monotonic() > end:
                raise DeviceError(
                    f"{self._where} does not become active; its state is {self._state_said}{self._states.errors}"
                )
            self._refuse_others()
            if meanwhile():
                return  # the loop ends before its first instant, and deactivation brakes
        self._released = True
        self._send(self._last_torque)
        self.state.to(LifeCycle.active)

    def revoke(self, reason: str) -> None:
        """A reason to stop: from now on only what lowers is sent."""
        self.session.permit.lose(reason)
        flush(self._bus)

    # Every cycle

    def read(self) -> None:
        permit = self.session.permit
        left = self._arrived * 1e-9 + PATIENCE * self.cycle - self._environment.monotonic()
        before = self._cycle_number
        came = self._states.wait(max(left, 0.0))
        if sentence := permit.hold_up(
            self._environment.monotonic_ns()
        ):  # the cause comes before its effects
            raise SafeStop(self.name, f"{sentence}{self._states.flood}")
        if came:
            # What is missing in the numbers is lost, but for what was counted as silence already. An arm whose own time has
            # stood still is not ahead of us: its numbers come later than they were waited for.
            gap = (self._cycle_number - before) % self.frames.cycles
            missing = gap - 1 - self._silent_cycles
            reason = self.monitor.lose(max(missing, 0))
            self.monitor.observe(lost=False)
            self._silent_cycles = 0
        else:
            self._deadline_moves()
            reason = self.monitor.lose(1)
        if self._silent_cycles * self.cycle > self._age_limit:
            reason = reason or (
                f"the last state frame is {self._silent_cycles * self.cycle:.4g} s old, its limit is {self._age_limit:g} s"
            )
        if self._states.problem:
            raise SafeStop(self.name, self._states.problem)
        if reason:
            raise SafeStop(self.name, f"{reason}{self._states.flood}{self._states.errors}")
        if self.session.is_obeyed_elsewhere:
            raise SafeStop(
                self.name,
                f"the arm obeys controller {self.session.obeyed}; this is controller {self.session.number}",
            )
        if permit.lost:
            raise SafeStop(self.name, self._lost_permit())
        reason = self.limits.measured(self.values["joint_position"], self.values["joint_velocity"])
        if reason:
            raise SafeStop(self.name, reason)

    def _lost_permit(self) -> str:
        if self._reports_state and self.session.state is not LifeCycle.active:
            return (
                f"the arm went to {self._state_said} by itself; the last command that it had was {self._command_age:.0f} cycles old"
                f"{self._states.errors}"
            )
        return f"{self.session.permit.lost}{self._states.errors}"

    def _deadline_moves(self) -> None:
        """No frame: the next one is expected a cycle later. Its number is not made up: an answer names what was received."""
        self._arrived += round(self.cycle * 1e9)
        self._silent_cycles += 1

    def write(self) -> None:
        torque, reason = self.limits.command(self.values["joint_torque_command"], self._last_torque)
        mode = self.session.answer(self._environment.monotonic_ns())
        reason = (
            reason
            or self.session.permit.lost
            or ("it has not been activated" if mode is not Mode.torque else None)
        )
        if reason:
            raise SafeStop(self.name, reason)
        self._put(mode, torque)
        if reason := self.session.permit.lost:
            raise SafeStop(self.name, reason)
        self._last_torque = torque

    # The end

    def ramp_down(self, elapsed: float) -> bool:
        if self._bus is None or not self._released:
            return True
        if self._stopping_torque is None:
            self._stopping_torque = self._last_torque.copy()
        if self._stops_itself:  # only watched: a command now would cut its own ramp short
            self._states.wait(PATIENCE * self.cycle)
            return self.at_rest or elapsed > GIVE_UP * self.ramp.time
        velocity = self.values["joint_velocity"]
        if self.ramp.over(velocity, elapsed) or self.state.now is not LifeCycle.active:
            self._send(np.zeros_like(velocity), brake=True)
            self._states.wait(2 * self.cycle)
            return self.at_rest or elapsed > GIVE_UP * self.ramp.time
        wanted = self.ramp.torque(self._stopping_torque, velocity, elapsed)
        torque, _ = self.limits.command(wanted, self._last_torque)
        self._send(torque)
        self._last_torque = torque
        self._states.wait(PATIENCE * self.cycle)
        return False

    @property
    def _stops_itself(self) -> bool:
        """The arm reports that it is in a stop of its own."""
        return self._reports_state and self.session.state in STOPPED

    @property
    def at_rest(self) -> bool:
        """As the arm reports it; of one that does not, a state frame since the brakes were commanded."""
        if "brakes" in self.frames.state:
            return self._braked
        if self._reports_state:
            return self.session.state is not LifeCycle.active
        return self._brake_sent and not self._answered

    def on_error(self, reason: str) -> None:
        if self.state.now is LifeCycle.active:
            self._brake()
            self.state.to(LifeCycle.safe_stop)

    def deactivate(self) -> None:
        if self._bus is None:
            return
        if self._released:  # also where activation was given up half-way
            self._brake()
        if self.state.now in (LifeCycle.active, LifeCycle.safe_stop):
            self.state.to(LifeCycle.inactive)
        self._bus.shutdown()
        self._bus = None

    def _brake(self) -> None:
        if self._bus is not None and not self._stops_itself:
            self._send(np.zeros(self.options.joints), brake=True)

    def report(self) -> Mapping[str, float]:
        counts = {
            "state_frames_accepted": self._states.receiver.accepted,
            "state_frames_rejected": self._states.receiver.refused,
            "cycles_lost": self.monitor.lost,
            "longest_loss_cycles": self.monitor.longest_row,
            "commands_sent": self._sender.sent,
            "commands_late_or_lost": self.late_commands,
        }
        acted = {f"{name}_acted": count for name, count in self.limits.acted.items()}
        return {name: float(count) for name, count in {**counts, **acted}.items()}

    def histograms(self) -> Mapping[str, Histogram]:
        return {
            f"{self.name}: wake-up after the state frame": self.wake_up,
            f"{self.name}: answer to it": self.answer,
        }

    # Frames

    def _is_stale(self, numbers: Mapping[str, list[float]]) -> bool:
        """Whether the frame, new as it is, says that it is from the cycle of the last one, or from one before."""
        ahead = (int(numbers["cycle"][0]) - self._cycle_number) % self.frames.cycles
        return self.state.now is LifeCycle.active and not 0 < ahead < self.frames.cycles // 2

    def _take(self, numbers: Numbers, now: int, empty_at: int) -> bool:
        """One state frame, read at `now` [ns]; it was not sent before `empty_at`. Whether it is used."""
        if self._is_stale(numbers):
            self._states.receiver.rejected["stale"] += 1
            return False
        late = self._environment.time_ns() * 1e-9 - self._states.stamp
        if 0.0 <= late < 1.0 and self.state.now is LifeCycle.active:
            self.wake_up.add(int(late * 1e9))
        for name in MEASURED:
            self.values[name][:] = numbers[name]
        self._cycle_number = int(numbers["cycle"][0]) % self.frames.cycles
        self._arrived = now
        self._answered = False
        session, echoed = self.session, None
        if "echoed_cycle" in numbers:
            echoed = int(numbers["echoed_cycle"][0]) % self.frames.cycles
            if self.state.now is LifeCycle.active and session.state is LifeCycle.active:
                self.late_commands += echoed != (self._cycle_number - 1) % self.frames.cycles
        self._command_age = numbers.get("command_age", (0.0,))[0]
        self._braked = numbers.get("brakes", (0.0,))[0] > 0.5
        state: LifeCycle | None = None
        if self._reports_state:
            number = numbers["life_cycle"][0]
            state = self.frames.life_cycle(number)
            self._state_said = (
                f"a state of the unknown number {number:g}" if state is None else state.name
            )
            # A number without a meaning is no reason to go on.
            state = LifeCycle.fault if state is None else state
        session.report(state, int(numbers.get("obeyed_controller", (0,))[0]), empty_at, echoed)
        return True

    def _send(self, torque: Array, *, brake: bool = False) -> None:
        """The command that the session allows now, with this torque if it is one of torque."""
        self._put(self.session.answer(self._environment.monotonic_ns(), brake=brake), torque)

    def _put(self, mode: Mode, torque: Array) -> None:
        session, clock = self.session, self._environment.monotonic_ns
        if (
            not self._has_modes
            and mode is not Mode.torque
            and not session.permits(Mode.torque, clock())
        ):
            return  # without modes every frame is a torque frame
        if mode is not Mode.torque:
            torque = np.zeros_like(torque)
        self._brake_sent = mode is Mode.brake
        sent = self._sender.send({
            "answered_cycle": (float(self._cycle_number),),
            "controller": (float(session.number),),
            "mode": (float(self.frames.mode_number(mode)),),
            "joint_torque_command": torque.tolist(),
        }, lambda: session.permits(mode, clock()))  # fmt: skip
        if sent:
            now = clock()
            session.wrote(self._cycle_number, now)
            if not self._answered and self.state.now is LifeCycle.active:
                self.answer.add(now - self._arrived)
        self._answered = True
