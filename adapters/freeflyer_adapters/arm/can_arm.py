"""Device driver of an arm on CAN.

The arm sends one state frame in each cycle. The state frames are the clock of the loop: each cycle
of the loop starts with a state frame. The host answers each state frame with one command frame.

Terms in this file:

- Session: one activation of the arm by this host. Each session has a random session number.
- Claim: a command frame with a new session number. After the arm has accepted the claim, it echoes
  the number in its state frames.
- Controller: a host that sends command frames to an arm.
- Role: name of a quantity in a frame, for example `joint_position` (`frames.py`).
- Permit: object that decides whether the host may send frames that give power to the arm
  (`permit.py`).
- Graded stop: the torque decreases to zero, then the brakes engage.
"""

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
from freeflyer_adapters.arm.state_receiver import Numbers, StateFrames
from freeflyer_adapters.can.link import Receiver, Sender, flush, open_bus
from freeflyer_adapters.can.second_sender import LISTEN
from freeflyer_adapters.device import parameters as device_parameters
from freeflyer_adapters.device.device import LifeCycle, SafeStop, State
from freeflyer_adapters.device.limits import ArmLimits
from freeflyer_adapters.device.permit import Permit
from freeflyer_adapters.device.quality import QualityMonitor
from freeflyer_adapters.device.ramp_down import RampDown
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.foundation.histogram import Histogram

MEASURED = ("joint_position", "joint_velocity", "joint_torque")
BRAKE_TIMEOUT = 4.0
"""Longest duration of the graded stop, as a multiple of the ramp-down time.

After this time, the host no longer waits for the brakes. Then only the watchdog of the arm can
engage the brakes.
"""
FRAME_TIMEOUT = 1.5
"""Time since the last state frame [cycles] after which the next state frame counts as lost."""


class CanArm:
    """Host side of an arm on CAN. Implements `freeflyer_adapters.device.device.Device`."""

    is_clock = True

    def __init__(self, name: str, options: ArmOptions) -> None:
        self.name, self.options = name, options
        self.state = State(name)
        self._environment = environment.present()
        n = options.joints
        self.frames = ArmFrames(options.frames, n)
        self.ports: Mapping[str, Port] = device_parameters.arm_ports(n, device_parameters.ARM)
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
        self._state_text = "a stop" if not self._reports_state else self.session.state.name
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
        """Sentences for the user about what this arm cannot reject or report by itself."""
        return self.frames.cannot_refuse(self.implicit)

    @property
    def woken(self) -> int:
        return self._arrived

    @property
    def step(self) -> float:
        return float(self.values["period"][0])

    # Before the activation

    def configure(self) -> None:
        # Check the settings and derive the limits.
        v = self.values
        device_parameters.check(self.name, device_parameters.ARM, v)
        self.cycle = self.step
        self.limits = ArmLimits(v, self.cycle)
        self.monitor = QualityMonitor.of(f"state frames of {self.name}", v, self.cycle)
        self.ramp = RampDown.of(v)
        self._age_limit = float(v["state_age_limit"][0])
        # Check that the DBC signals can represent the ranges of all commands and measurements.
        effort = v["joint_effort_limit"]
        self.frames.check_ranges({
            "joint_torque_command": [(-e, e) for e in effort],
            "joint_torque": [(-e, e) for e in effort],
            "joint_position": list(zip(v["joint_lower_limit"], v["joint_upper_limit"], strict=True)),
            "joint_velocity": [(-w, w) for w in v["joint_velocity_limit"]],
        })  # fmt: skip
        # Open the bus. Command frames are also received, to detect a second controller.
        o = self.options
        description = self.frames.description
        received = [
            self.frames.state,
            self.frames.command,
            *([] if description is None else [description]),
        ]
        self._bus = open_bus(o.interface, o.channel, self.frames.is_fd, received, o.bus)
        self._sender = Sender(self._bus, self.frames.command)
        self._states = StateFrames(self._bus, self.frames, self._sender, self._take)
        self.session = self._new_session()
        # Compare the arm with the scenario. Then receive state frames for some time before the
        # first transmission, to detect a second arm or a second controller.
        if description is not None:
            described = self._described(Receiver(description))
            compare(self._where, description, described, v, o.joints)
        self._observe(LISTEN)
        self.state.to(LifeCycle.inactive)

    @property
    def _where(self) -> str:
        return f"{self.name} on CAN {self.options.interface}:{self.options.channel}"

    def _described(self, receiver: Receiver) -> dict[str, list[float]]:
        """Wait for a description frame. Return the values of the frame: role -> values [SI].

        `receiver`: receiver of the description frames. If another controller has activated the
        arm, the arm sends no description frames. However, its state frames can show the other
        controller. Therefore the state frames are checked during the wait. Raises DeviceError if no
        description frame arrives, and in the cases of `_check_conflicts`.
        """
        end = self._deadline()
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
                self._check_conflicts()
        raise DeviceError(self._silence("description", receiver))

    def _deadline(self) -> float:
        return self._environment.monotonic() + float(self.values["configure_timeout"][0])

    def _silence(self, what: str, receiver: Receiver) -> str:
        return f"{self._where} {self._states.silence(what, receiver, float(self.values['configure_timeout'][0]))}"

    def _observe(self, frames: int) -> None:
        """Receive `frames` state frames, and send nothing.

        Raises DeviceError if a state frame does not arrive in time, and in the cases of
        `_check_conflicts`. If `frames` is LISTEN, DeviceError is also raised if the rate of the
        state frames shows a second arm.
        """
        end = self._deadline() + 2 * frames * self.cycle
        self._states.drain()
        start, before = self._environment.monotonic(), self._states.received
        for _ in range(frames):
            if not self._states.wait(end - self._environment.monotonic()):
                raise DeviceError(self._silence("state", self._states.receiver))
            self._check_conflicts()
        if frames == LISTEN:
            cycles = (self._environment.monotonic() - start) / self.cycle
            problem = self._states.rate_problem(self._states.received - before, cycles)
            if problem:
                raise DeviceError(f"{self._where}: {problem}")

    def _check_conflicts(self) -> None:
        """Raise DeviceError if a second arm or a second controller is detected.

        Also raise DeviceError if the arm is in the state active and this run has not activated it.
        """
        session = self.session
        if self._states.problem:
            raise DeviceError(f"{self._where}: {self._states.problem}")
        if session.has_other_controller:
            raise DeviceError(
                f"{self._where} accepts commands from controller {session.echoed_number} already; this run is controller {session.number}: "
                f"stop the other controller first"
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
        """Send a command, so that the session does not end while other devices are activated."""
        if self.session.phase is Phase.claiming or self.state.now is LifeCycle.active:
            self._states.wait(0.0)
            self._send(np.zeros(self.options.joints))

    def check_start(self) -> None:
        self._observe(1)
        if reason := self.limits.start(self.values):
            raise DeviceError(f"{self._where}: {reason}")

    def prepare(self) -> None:
        """Claim a new session number, and wait until the arm accepts the claim.

        A claim also changes the arm from the state safe_stop or fault to the state inactive. The
        brakes stay engaged. Raises DeviceError if the arm does not accept the claim.
        """
        self.session = session = self._new_session()
        self._released, self._stopping_torque = False, None
        session.claim()
        end = self._deadline()
        has_received = False
        while not session.is_claimed:
            self._send(np.zeros(self.options.joints))
            has_received = (
                self._states.wait(min(2 * self.cycle, end - self._environment.monotonic()))
                or has_received
            )
            self._check_conflicts()
            if self._environment.monotonic() > end:
                if not has_received:
                    raise DeviceError(self._silence("state", self._states.receiver))
                raise DeviceError(
                    f"{self._where} sends its state ({self._state_text}), but does not accept this controller's commands; the echoed "
                    f"session number is {session.echoed_number or 'none'}{self._states.errors}"
                )

    def activate(self, meanwhile: Callable[[], bool]) -> None:
        """Activate the arm.

        The first torque command is zero, like the commands while the brakes are engaged. Torque
        commands do not include the torque that carries the weight of the arm. The arm itself adds
        this torque.
        """
        session = self.session
        self._states.drain()
        if session.permit.lost:
            raise DeviceError(f"{self._where} was not activated: {session.permit.lost}")
        session.activate(self._environment.monotonic_ns())
        self._last_torque = np.zeros(self.options.joints)
        end, silent = self._deadline(), 0
        while session.phase is not Phase.commanding:
            self._released = True
            self._send(self._last_torque)
            received = self._states.wait(min(2 * self.cycle, end - self._environment.monotonic()))
            # If no state frame arrives for longer than the age limit, revoke the permit. In this
            # time, the arm may have become active, stopped by itself, and ended the session.
            silent = 0 if received else silent + 1
            if 2 * silent * self.cycle > self._age_limit:
                session.permit.lose(self._silence("state", self._states.receiver))
            if session.permit.lost:
                raise DeviceError(f"{self._where} was not activated: {session.permit.lost}")
            if self._environment.monotonic() > end:
                raise DeviceError(
                    f"{self._where} does not become active; its state is {self._state_text}{self._states.errors}"
                )
            self._check_conflicts()
            if meanwhile():
                return  # the user stops the run before its first cycle; `deactivate` brakes the arm
        self._released = True
        self._send(self._last_torque)
        self.state.to(LifeCycle.active)

    def revoke(self, reason: str) -> None:
        """Revoke the permit. From now on, only frames of the graded stop are sent."""
        self.session.permit.lose(reason)
        flush(self._bus)

    # In every cycle

    def read(self) -> None:
        permit = self.session.permit
        left = self._arrived * 1e-9 + FRAME_TIMEOUT * self.cycle - self._environment.monotonic()
        before = self._cycle_number
        received = self._states.wait(max(left, 0.0))
        # Check for a delay of the loop first, because a delay causes the errors that follow.
        if sentence := permit.hold_up(self._environment.monotonic_ns()):
            raise SafeStop(self.name, f"{sentence}{self._states.flood}")
        # Count lost frames.
        if received:
            # Each missing cycle number is a lost frame. Subtract the frames that were already
            # counted at their deadlines (`_silent_cycles`). If the arm itself has paused, no number
            # is missing.
            gap = (self._cycle_number - before) % self.frames.cycles
            missing = gap - 1 - self._silent_cycles
            reason = self.monitor.lose(max(missing, 0))
            self.monitor.observe(lost=False)
            self._silent_cycles = 0
        else:
            self._expect_next()
            reason = self.monitor.lose(1)
        if self._silent_cycles * self.cycle > self._age_limit:
            reason = reason or (
                f"the last state frame is {self._silent_cycles * self.cycle:.4g} s old, its limit is {self._age_limit:g} s"
            )
        # Stop if there is a second arm or controller, if too many frames were lost, or if the arm
        # has left the state active.
        if self._states.problem:
            raise SafeStop(self.name, self._states.problem)
        if reason:
            raise SafeStop(self.name, f"{reason}{self._states.flood}{self._states.errors}")
        if self.session.has_other_controller:
            raise SafeStop(
                self.name,
                f"the arm accepts commands from controller {self.session.echoed_number}; this run is controller {self.session.number}",
            )
        if permit.lost:
            raise SafeStop(self.name, self._lost_permit())
        # Stop if a measured position or speed exceeds its limit.
        reason = self.limits.measured(self.values["joint_position"], self.values["joint_velocity"])
        if reason:
            raise SafeStop(self.name, reason)

    def _lost_permit(self) -> str:
        if self._reports_state and self.session.state is not LifeCycle.active:
            return (
                f"the arm went to {self._state_text} by itself; the last command that it accepted was {self._command_age:.0f} cycles old"
                f"{self._states.errors}"
            )
        return f"{self.session.permit.lost}{self._states.errors}"

    def _expect_next(self) -> None:
        """Move the deadline for the next state frame by one cycle, after a frame did not arrive.

        The next command still answers the cycle number of the last received state frame.
        """
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

    # During and after a stop

    def ramp_down(self, elapsed: float) -> bool:
        if self._bus is None or not self._released:
            return True
        if self._stopping_torque is None:
            self._stopping_torque = self._last_torque.copy()
        if self._stops_itself:  # send nothing: a command would end the ramp-down of the arm early
            self._states.wait(FRAME_TIMEOUT * self.cycle)
            return self.at_rest or elapsed > BRAKE_TIMEOUT * self.ramp.time
        velocity = self.values["joint_velocity"]
        if self.ramp.over(velocity, elapsed) or self.state.now is not LifeCycle.active:
            self._send(np.zeros_like(velocity), brake=True)
            self._states.wait(2 * self.cycle)
            return self.at_rest or elapsed > BRAKE_TIMEOUT * self.ramp.time
        wanted = self.ramp.torque(self._stopping_torque, velocity, elapsed)
        torque, _ = self.limits.command(wanted, self._last_torque)
        self._send(torque)
        self._last_torque = torque
        self._states.wait(FRAME_TIMEOUT * self.cycle)
        return False

    @property
    def _stops_itself(self) -> bool:
        """Whether the arm reports that it has started a stop by itself."""
        return self._reports_state and self.session.state in STOPPED

    @property
    def at_rest(self) -> bool:
        """Whether the arm is known to be at rest.

        If the arm reports its brakes, the brakes must be engaged. If the arm reports only its life
        cycle state, this state must not be active. If the arm reports neither brakes nor life cycle
        state, a state frame must have arrived after the brake command.
        """
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
        if self._released:  # also after an incomplete activation
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
        return {name: float(count) for name, count in {**counts, **self.limits.report()}.items()}

    def histograms(self) -> Mapping[str, Histogram]:
        return {
            f"{self.name}: wake-up after the state frame": self.wake_up,
            f"{self.name}: answer to it": self.answer,
        }

    # Frames

    def _is_stale(self, numbers: Mapping[str, list[float]]) -> bool:
        """Return whether a state frame is not newer than the last used state frame.

        `numbers`: role -> values of the frame. The cycle numbers are compared. The result is always
        False if this device is not in the state active.
        """
        ahead = (int(numbers["cycle"][0]) - self._cycle_number) % self.frames.cycles
        return self.state.now is LifeCycle.active and not 0 < ahead < self.frames.cycles // 2

    def _take(self, numbers: Numbers, now: int, empty_at: int) -> bool:
        """Process a state frame. Return True if it is used, or False if it is stale.

        `numbers`: role -> values of the frame in SI units. `now` [ns]: time when the frame was
        read. `empty_at` [ns]: the frame was not sent before this time.
        """
        if self._is_stale(numbers):
            self._states.receiver.rejected["stale"] += 1
            return False
        late = self._environment.time_ns() * 1e-9 - self._states.stamp
        if 0.0 <= late < 1.0 and self.state.now is LifeCycle.active:
            self.wake_up.add(int(late * 1e9))
        # Store the measurements and the cycle numbers.
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
        # Pass the state of the arm to the session.
        self._command_age = numbers.get("command_age", (0.0,))[0]
        self._braked = numbers.get("brakes", (0.0,))[0] > 0.5
        state: LifeCycle | None = None
        if self._reports_state:
            number = numbers["life_cycle"][0]
            state = self.frames.life_cycle(number)
            self._state_text = (
                f"a state with the unknown number {number:g}" if state is None else state.name
            )
            # An unknown number counts as a fault.
            state = LifeCycle.fault if state is None else state
        session.report(state, int(numbers.get("obeyed_controller", (0,))[0]), empty_at, echoed)
        return True

    def _send(self, torque: Array, *, brake: bool = False) -> None:
        """Send a command with the mode that the session allows.

        In the mode torque, the frame contains `torque`. In all other modes, the torques in the
        frame are zero. `brake`: whether the arm must brake now.
        """
        self._put(self.session.answer(self._environment.monotonic_ns(), brake=brake), torque)

    def _put(self, mode: Mode, torque: Array) -> None:
        session, clock = self.session, self._environment.monotonic_ns
        if (
            not self._has_modes
            and mode is not Mode.torque
            and not session.permits(Mode.torque, clock())
        ):
            return  # an arm without modes treats every command frame as a torque command
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
