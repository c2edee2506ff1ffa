"""The arm on CAN as a device: its state frame is the clock, and every state frame is answered with one command."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping

import can
import numpy as np

from freeflyer.component import Array, Port
from freeflyer_adapters import outside
from freeflyer_adapters import settings as all_settings
from freeflyer_adapters.arm.description import compare
from freeflyer_adapters.arm.frames import ArmFrames, Mode
from freeflyer_adapters.arm.link import Receiver, Sender, open_bus
from freeflyer_adapters.arm.options import ArmOptions
from freeflyer_adapters.device import DeviceError, LifeCycle, SafeStop, State
from freeflyer_adapters.histogram import Histogram
from freeflyer_adapters.limits import ArmLimits
from freeflyer_adapters.quality import QualityMonitor
from freeflyer_adapters.ramp_down import RampDown

MEASURED = ("joint_position", "joint_velocity", "joint_torque")
GIVE_UP = 4.0
"""An arm that has not confirmed its brakes after so many ramp-down times is left to its own watchdog."""
PATIENCE = 1.5
"""A state frame is lost when it has not come after so many cycles since the last one."""


class CanArm:
    """See `freeflyer_adapters.device.Device` for the calls."""

    is_clock = True

    def __init__(self, name: str, options: ArmOptions) -> None:
        self.name, self.options = name, options
        self.state = State(name)
        self._outside = outside.present()
        n = options.joints
        self.frames = ArmFrames(options.frames, n)
        self.ports: Mapping[str, Port] = all_settings.arm_ports(n, all_settings.ARM)
        self.values: Mapping[str, Array] = {p.name: np.array(p.start or (0.0,) * p.size) for p in self.ports.values()}
        self.controller = 1 + secrets.randbelow(self.frames.controllers)
        self.wake_up, self.answer = Histogram(), Histogram()
        self.late_commands = 0
        self._bus: can.BusABC | None = None
        self._cycle_number = 0
        self._arrived = 0
        self._last_torque = np.zeros(n)
        self._stopping_torque: Array | None = None
        self._obeyed = 0
        self._tells_state = "life_cycle" in self.frames.state
        # An arm that cannot say it is taken to be active while its frames come.
        self._arm_state = LifeCycle.unconfigured if self._tells_state else LifeCycle.active
        self._state_said = self._arm_state.name
        self._command_age = 0.0
        self._answered = True
        self._silent_cycles = 0
        self._braked = False
        self._brake_sent = False
        self._released = False
        """Whether a command may have released the brakes."""

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
        self.ramp = RampDown(time=float(v["ramp_down_time"][0]), damping=float(v["ramp_down_damping"][0]))
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
        seen = [self.frames.state] if description is None else [self.frames.state, description]
        self._bus = open_bus(o.interface, o.channel, self.frames.is_fd, seen, o.bus)
        self._sender = Sender(self._bus, self.frames.command)
        self._states = Receiver(self.frames.state)
        if description is not None:
            described = self._described(Receiver(description))
            compare(self._where, description, described, v, o.joints)
        self._claim()
        self.state.to(LifeCycle.inactive)

    @property
    def _where(self) -> str:
        return f"{self.name} on CAN {self.options.interface}:{self.options.channel}"

    def _described(self, receiver: Receiver) -> dict[str, list[float]]:
        """Waits for a description; an arm that is active for somebody else sends none, but its state frames say for whom."""
        end = self._outside.monotonic() + float(self.values["configure_timeout"][0])
        while True:
            message = self._received(end - self._outside.monotonic())
            if message is None or self._outside.monotonic() > end:
                raise DeviceError(self._silence("description", receiver))
            found = receiver.take(message)
            if found is not None:
                return found
            state = self._states.take(message)
            if state is not None:
                self._take(state, self._outside.monotonic_ns())
                self._refuse_another_controller()

    def _silence(self, what: str, receiver: Receiver) -> str:
        waited = self.values["configure_timeout"][0]
        why = f"; frames came but were refused: {dict(receiver.rejected)}" if receiver.rejected else ""
        return (
            f"{self._where} sends no {what} frame within {waited:g} s{why}: is the arm (or `freeflyer facility`) running on this "
            f"channel, and not active for somebody else?"
        )

    def _claim(self) -> None:
        """The first measurement, and the arm's word that it listens to us."""
        end = self._outside.monotonic() + float(self.values["configure_timeout"][0])
        self._drain()
        while True:
            if not self._wait(end - self._outside.monotonic()):
                raise DeviceError(self._silence("state", self._states))
            if self._outside.monotonic() > end:
                raise DeviceError(
                    f"{self._where} sends its state, but does not take this controller's commands: it obeys {self._obeyed or 'nobody'}"
                )
            self._refuse_another_controller()
            if self._obeyed == self.controller or "obeyed_controller" not in self.frames.state:
                return
            self._send(Mode.idle, self._last_torque * 0.0)

    def _refuse_another_controller(self) -> None:
        if self._obeyed not in (0, self.controller):
            raise DeviceError(
                f"{self._where} obeys controller {self._obeyed} already; this is controller {self.controller}: stop that one first"
            )

    @property
    def _is_active(self) -> bool:
        return self._arm_state is LifeCycle.active

    def stay(self) -> None:
        """While other devices take their time: the arm is not to forget who has claimed it."""
        if self.state.now is LifeCycle.inactive and not self._released:
            self._wait(0.0)
            self._send(Mode.idle, np.zeros(self.options.joints))

    def check_start(self) -> None:
        self._claim()
        gap = np.abs(self.values["joint_position"] - self.values["start_joint_position"])
        tolerance = float(self.values["start_tolerance"][0])
        if not (gap <= tolerance).all():
            j = int(np.argmax(gap))
            raise DeviceError(
                f"{self._where}: joint {j + 1} is at {self.values['joint_position'][j]:.4f} rad, the scenario starts at "
                f"{self.values['start_joint_position'][j]:.4f} rad, and {tolerance:g} rad is the largest distance allowed: move the arm there"
            )

    def activate(self, meanwhile: Callable[[], bool]) -> None:
        """The arm stands braked; the first torque beyond gravity is none, which is what it holds now."""
        self._claim()
        self._last_torque = np.zeros(self.options.joints)
        end = self._outside.monotonic() + float(self.values["configure_timeout"][0])
        while not self._is_active:
            stopped = self._arm_state in (LifeCycle.safe_stop, LifeCycle.fault)
            self._released = True
            self._send(Mode.reset if stopped else Mode.torque, self._last_torque)
            if not self._wait(end - self._outside.monotonic()) or self._outside.monotonic() > end:
                raise DeviceError(f"{self._where} does not become active; its state is {self._state_said}")
            if meanwhile():
                return  # the loop ends before its first instant, and deactivation brakes
        self._released = True
        self._send(Mode.torque, self._last_torque)
        self.state.to(LifeCycle.active)

    # Every cycle

    def read(self) -> None:
        left = self._arrived * 1e-9 + PATIENCE * self.cycle - self._outside.monotonic()
        before = self._cycle_number
        if self._wait(max(left, 0.0)):
            # What is missing in the numbers is lost, but for what was counted as silence already. An arm whose own time has
            # stood still is not ahead of us: its numbers come later than they were waited for.
            gap = (self._cycle_number - before) % self.frames.cycles
            missing = gap - 1 - self._silent_cycles
            reason = self.monitor.lose(max(missing, 0))
            self.monitor.observe(lost=False)
            self._silent_cycles = 0
            came = True
        else:
            self._deadline_moves()
            reason = self.monitor.lose(1)
            came = False
        if self._silent_cycles * self.cycle > self._age_limit:
            reason = reason or (
                f"the last state frame is {self._silent_cycles * self.cycle:.4g} s old, its limit is {self._age_limit:g} s"
            )
        if reason:
            raise SafeStop(self.name, reason)
        if came and not self._is_active:
            raise SafeStop(
                self.name,
                f"the arm went to {self._state_said} by itself; the last command that it had was {self._command_age:.0f} cycles old",
            )
        if self._obeyed not in (0, self.controller):
            raise SafeStop(self.name, f"the arm obeys controller {self._obeyed}; this is controller {self.controller}")
        reason = self.limits.measured(self.values["joint_position"], self.values["joint_velocity"])
        if reason:
            raise SafeStop(self.name, reason)

    def _deadline_moves(self) -> None:
        """No frame: the next one is expected a cycle later. Its number is not made up: who answers says what he has seen."""
        self._arrived += round(self.cycle * 1e9)
        self._silent_cycles += 1

    def write(self) -> None:
        torque, reason = self.limits.command(self.values["joint_torque_command"], self._last_torque)
        if reason:
            raise SafeStop(self.name, reason)
        self._send(Mode.torque, torque)
        self._last_torque = torque

    # The end

    def ramp_down(self, elapsed: float) -> bool:
        if self._bus is None or self.state.now is not LifeCycle.active:
            return True
        if self._stopping_torque is None:
            self._stopping_torque = self._last_torque.copy()
        if self._stops_itself:  # only watched: a command now would cut its own ramp short
            self._wait(PATIENCE * self.cycle)
            return self.at_rest or elapsed > GIVE_UP * self.ramp.time
        velocity = self.values["joint_velocity"]
        if self.ramp.over(velocity, elapsed):
            self._send(Mode.brake, np.zeros_like(velocity))
            self._wait(2 * self.cycle)
            return self.at_rest or elapsed > GIVE_UP * self.ramp.time
        wanted = self.ramp.torque(self._stopping_torque, velocity, elapsed)
        torque, _ = self.limits.command(wanted, self._last_torque)
        self._send(Mode.torque, torque)
        self._last_torque = torque
        self._wait(PATIENCE * self.cycle)
        return False

    @property
    def _stops_itself(self) -> bool:
        """The arm's own word that it is in a stop of its own."""
        return self._tells_state and self._arm_state in (LifeCycle.safe_stop, LifeCycle.fault)

    @property
    def at_rest(self) -> bool:
        """The arm's own word; of one that cannot say it, a state frame since the brakes were commanded."""
        if "brakes" in self.frames.state:
            return self._braked
        if self._tells_state:
            return not self._is_active
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
            self._send(Mode.brake, np.zeros(self.options.joints))

    def report(self) -> Mapping[str, float]:
        counts = {
            "state_frames_accepted": self._states.accepted,
            "state_frames_rejected": self._states.refused,
            "cycles_lost": self.monitor.lost,
            "longest_loss_cycles": self.monitor.longest_row,
            "commands_sent": self._sender.sent,
            "commands_late_or_lost": self.late_commands,
        }
        acted = {f"{name}_acted": count for name, count in self.limits.acted.items()}
        return {name: float(count) for name, count in {**counts, **acted}.items()}

    def histograms(self) -> Mapping[str, Histogram]:
        return {f"{self.name}: wake-up after the state frame": self.wake_up, f"{self.name}: answer to it": self.answer}

    # Frames

    def _received(self, timeout: float) -> can.Message | None:
        assert self._bus is not None
        try:
            return self._bus.recv(max(timeout, 0.0))
        except can.CanError:
            return None

    def _drain(self) -> None:
        while self._received(0.0) is not None:
            pass
        self._states.forget()

    def _wait(self, timeout: float) -> bool:
        """Wait for a state frame, and take the newest if there are several."""
        end = self._outside.monotonic() + timeout
        came = False
        left = timeout
        while True:
            message = self._received(0.0 if came else left)
            if message is None:
                if came:
                    return True
            else:
                now = self._outside.monotonic_ns()
                numbers = self._states.take(message)
                if numbers is not None and self._is_stale(numbers):
                    self._states.rejected["stale"] += 1
                elif numbers is not None:
                    late = self._outside.time_ns() * 1e-9 - message.timestamp
                    if 0.0 <= late < 1.0 and self.state.now is LifeCycle.active:
                        self.wake_up.add(int(late * 1e9))
                    self._take(numbers, now)
                    came = True
            if not came:
                left = end - self._outside.monotonic()
                if left <= 0.0:
                    return False

    def _is_stale(self, numbers: Mapping[str, list[float]]) -> bool:
        """Whether the frame, new as it is, says that it is from the cycle of the last one, or from one before."""
        ahead = (int(numbers["cycle"][0]) - self._cycle_number) % self.frames.cycles
        return self.state.now is LifeCycle.active and not 0 < ahead < self.frames.cycles // 2

    def _take(self, numbers: Mapping[str, list[float]], now: int) -> None:
        for name in MEASURED:
            self.values[name][:] = numbers[name]
        self._cycle_number = int(numbers["cycle"][0]) % self.frames.cycles
        self._arrived = now
        self._answered = False
        if "echoed_cycle" in numbers and self.state.now is LifeCycle.active and self._is_active:
            expected = (self._cycle_number - 1) % self.frames.cycles
            if int(numbers["echoed_cycle"][0]) % self.frames.cycles != expected:
                self.late_commands += 1
        self._obeyed = int(numbers.get("obeyed_controller", (0,))[0])
        self._command_age = numbers.get("command_age", (0.0,))[0]
        self._braked = numbers.get("brakes", (0.0,))[0] > 0.5
        if self._tells_state:
            number = numbers["life_cycle"][0]
            state = self.frames.life_cycle(number)
            # A number that nobody knows is no reason to go on.
            self._arm_state = LifeCycle.fault if state is None else state
            self._state_said = f"a state of the unknown number {number:g}" if state is None else state.name

    def _send(self, mode: Mode, torque: Array) -> None:
        self._brake_sent = mode is Mode.brake
        sent = self._sender.send({
            "answered_cycle": (float(self._cycle_number),),
            "controller": (float(self.controller),),
            "mode": (float(self.frames.mode_number(mode)),),
            "joint_torque_command": torque.tolist(),
        })  # fmt: skip
        if not self._answered and sent and self.state.now is LifeCycle.active:
            self.answer.add(self._outside.monotonic_ns() - self._arrived)
        self._answered = True
