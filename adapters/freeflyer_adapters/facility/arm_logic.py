"""State machine of the virtual arm: session handling, life cycle and watchdog.

The module reads no clock and sends no frames. One call of `ArmLogic.begin` is one cycle. In every
cycle, the arm sends one state frame, which contains the cycle number.

A controller is a program that sends commands to the arm. Session: the time in which the arm accepts
the commands of one controller. The command frames of this controller contain a session number. A
session number expires when the arm leaves the state active, or when the controller commands the
brakes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from freeflyer.fmi.component import Array
from freeflyer_adapters.arm.frames import Mode
from freeflyer_adapters.device.device import LifeCycle, State
from freeflyer_adapters.device.ramp_down import RampDown

MOST_USED = 64
"""Maximum number of expired session numbers that are stored."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command from a valid frame.

    `controller`: session number in the frame. `answered`: cycle number of the state frame from
    which the command was computed. In this module, the command *answers* this state frame.
    `torque` (n) [N m]: commanded joint torques.
    """

    controller: int
    mode: Mode | None
    answered: int
    torque: Array


class ArmLogic:
    """State machine of the virtual arm.

    `joints`: number of joints. `cycle` [s]: time between two calls of `begin`.
    `watchdog` [cycles]: at this age of the last command, the arm goes to the state safe_stop.
    `silence` [cycles]: after this time without a frame of the controller, the session ends.
    `ramp`: torque of the ramp-down in the state safe_stop.
    `cycles`: number of different cycle numbers. After the last number, counting starts at 0 again.
    `implicit`: the arm has no session numbers and no mode `activate`. A torque frame activates the
    arm.
    `used`: expired session numbers, which cannot activate the arm. All sessions share this list.
    """

    def __init__(
        self,
        joints: int,
        *,
        cycle: float,
        watchdog: int,
        silence: int,
        ramp: RampDown,
        cycles: int = 1 << 24,
        implicit: bool = False,
        used: deque[int] | None = None,
    ) -> None:
        # Settings and life cycle.
        self.cycles, self.implicit = cycles, implicit
        self.period, self.watchdog, self.silence, self.ramp = cycle, watchdog, silence, ramp
        self.used: deque[int] = deque(maxlen=MOST_USED) if used is None else used
        self.life = State("the virtual arm")
        self.life.to(LifeCycle.inactive)
        # Contents of the state frame, and values that act on the model.
        self.controller = 0
        """Session number of the present session. Sent in every state frame. 0: no session."""
        self.cycle = 0
        """Number of the last state frame."""
        self.echoed = 0
        """Cycle number that the last accepted command answered. Sent in every state frame."""
        self.torque = np.zeros(joints)
        self.effort = np.full(joints, np.inf)
        """Largest accepted joint torques (n) [N m]. A command with a larger torque is rejected."""
        self.braked = True
        # Counters and events.
        self.lost = 0
        """Number of cycles, counted since the activation, in which no new command arrived."""
        self.foreign = 0
        """Number of commands that do not belong to the present session."""
        self.excessive = 0
        """Number of commands with a torque larger than `effort`."""
        self.ignored = 0
        """Number of torque frames outside the state active, plus number of invalid activations."""
        self.total_lost = 0
        self.was_active = False
        self.events: list[tuple[int, str]] = []
        self._echoes = 0
        """Number of state frames that have contained the present session number."""
        self._quiet = 0
        """Number of cycles since the last frame of the controller."""
        self._answered = 0
        """Cycle number that the last accepted command answered. Used by the watchdog."""
        self._stopping = 0
        """Number of cycles since the start of the ramp-down."""
        self._stopping_torque = np.zeros(joints)

    def again(self) -> ArmLogic:
        """Return a state machine for a new session, in the state inactive.

        The cycle number continues, and the expired session numbers are kept.
        """
        made = ArmLogic(
            len(self.torque),
            cycle=self.period,
            watchdog=self.watchdog,
            silence=self.silence,
            ramp=self.ramp,
            cycles=self.cycles,
            implicit=self.implicit,
            used=self.used,
        )
        made.cycle, made.effort = self.cycle, self.effort
        return made

    @property
    def command_age(self) -> int:
        """Age of the last accepted command at the last call of `begin` [cycles].

        The age counts from the state frame that the command answers. It is 0 if the arm has not
        been active in this session.
        """
        return (self.cycle - self._answered - 1) % self.cycles if self.was_active else 0

    @property
    def session_is_over(self) -> bool:
        """Whether the arm was active in this session and now has no controller."""
        return self.was_active and self.controller == 0

    def begin(self, commands: Sequence[Command], velocity: Array) -> None:
        """Start a new cycle. Update `torque` and `braked`. Both act until the next cycle.

        `commands`: commands received since the last state frame. `velocity` (n) [rad/s]: last
        measured joint velocities.
        """
        for command in commands:
            self._handle(command)
        # Watchdog: stop the arm if the last command is too old.
        if self.life.now is LifeCycle.active:
            age = (self.cycle - self._answered) % self.cycles
            if age >= 1:
                self.lost += 1
                self.total_lost += 1
            if age >= self.watchdog:
                self._stop(f"no command for {age} cycles")
        # State safe_stop: ramp the torque down without commands.
        if self.life.now is LifeCycle.safe_stop and not self.braked:
            elapsed = self._stopping * self.period
            self._stopping += 1
            self.torque = self.ramp.torque(self._stopping_torque, velocity, elapsed)
            if self.ramp.over(velocity, elapsed):
                self._brake()
        # End the session if the controller has sent no frame for longer than `silence`.
        self._quiet += 1
        if self.controller and self._quiet > self.silence:
            self._note(f"controller {self.controller} is silent")
            self.controller = 0
        self.cycle = (self.cycle + 1) % self.cycles
        # Count the state frame of this cycle, because this frame contains the session number.
        self._echoes = min(self._echoes + 1, self.watchdog) if self.controller else 0

    def _handle(self, command: Command) -> None:
        if not self._is_from_session(command):
            self.foreign += 1
            return
        self._quiet = 0
        if not (np.abs(command.torque) <= self.effort).all():  # NaN is rejected, too
            self.excessive += 1
            return
        if command.mode is Mode.reset:
            if (
                self.life.now in (LifeCycle.safe_stop, LifeCycle.fault)
                and self.braked
                and not self._is_used_up
            ):
                self._to(LifeCycle.inactive, "reset")
        elif command.mode is Mode.brake:
            self._use_up()
            if self.life.now is LifeCycle.active:
                self._to(LifeCycle.inactive, "brakes commanded")
            if self.life.now in (LifeCycle.inactive, LifeCycle.safe_stop):
                self._brake()
        elif self._is_activation(command):
            self._to(LifeCycle.active, "commanded")
            self.braked, self.was_active, self.lost = False, True, 0
            self._answered = self.echoed = command.answered
        if command.mode is Mode.torque:
            self._apply_torque(command)

    def _is_from_session(self, command: Command) -> bool:
        """Return whether a frame belongs to the present session.

        If there is no session, a frame of mode `reset` with a new session number starts a session.
        An implicit arm has no session numbers. Any frame starts a session of an implicit arm.
        """
        number = command.controller
        if number == 0 or number == self.controller:
            return number != 0
        if not self._may_begin_session(command):
            return False
        self.controller, self._echoes = number, 0
        self._note(f"accepts commands from controller {number}")
        return True

    def _may_begin_session(self, command: Command) -> bool:
        if self.implicit:
            return not self.controller
        return (
            command.mode is Mode.reset
            and not self.controller
            and command.controller not in self.used
        )

    @property
    def _is_used_up(self) -> bool:
        return not self.implicit and self.controller in self.used

    def _use_up(self) -> None:
        """Let the present session number expire: it cannot activate the arm again."""
        if not self.implicit and self.controller not in self.used:
            self.used.append(self.controller)

    def _is_activation(self, command: Command) -> bool:
        """Return whether the frame activates the arm.

        The frame must answer a recent state frame of this arm. If the arm has session numbers, this
        state frame must have contained the present session number.
        """
        age = (self.cycle - command.answered) % self.cycles
        if self.implicit:
            return (
                command.mode is Mode.torque
                and self.life.now is LifeCycle.inactive
                and age < self.watchdog
            )
        if command.mode is not Mode.activate:
            return False
        counts = self.life.now is LifeCycle.inactive and age < self._echoes and not self._is_used_up
        self.ignored += not counts and self.life.now is not LifeCycle.active
        return counts

    def _apply_torque(self, command: Command) -> None:
        if self.life.now is not LifeCycle.active:
            self.ignored += 1
            return
        # `older`: this command answers an older state frame than the last accepted command. So this
        # command was delayed or reordered.
        older = (command.answered - self._answered) % self.cycles >= self.cycles // 2
        if (self.cycle - command.answered) % self.cycles < self.watchdog and not older:
            self.torque = command.torque
            self._answered = self.echoed = command.answered

    def fail(self, reason: str) -> None:
        """Engage the brakes and go to the state fault, because the arm itself has failed."""
        if self.life.now is LifeCycle.fault:
            return
        self._to(LifeCycle.fault, reason)
        self._brake()

    def _stop(self, reason: str) -> None:
        self._to(LifeCycle.safe_stop, reason)
        self._stopping = 0
        self._stopping_torque = self.torque.copy()

    def _brake(self) -> None:
        self.braked = True
        self.torque = np.zeros_like(self.torque)

    def _to(self, following: LifeCycle, reason: str) -> None:
        if self.life.now is LifeCycle.active:
            self._use_up()
        self._note(f"{self.life.now.name} -> {following.name}: {reason}")
        self.life.to(following)

    def _note(self, event: str) -> None:
        self.events.append((self.cycle, event))
