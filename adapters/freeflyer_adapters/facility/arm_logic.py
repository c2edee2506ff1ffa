"""Controller of the virtual arm: session handling, life cycle and watchdog.

The module reads no clock and sends nothing. One call is one cycle.
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
"""Maximum number of stored expired session numbers."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """An accepted command frame; `torque` (n) [N m]."""

    controller: int
    mode: Mode | None
    answered: int
    torque: Array


class ArmLogic:
    """State machine of the arm's controller.

    `watchdog` [cycles]: age of the last command at which the arm goes to safe stop.
    `silence` [cycles]: time without a frame after which the arm releases its controller.
    `cycles`: modulus of the cycle numbers.
    `implicit`: the arm has no session numbers and no mode `activate`; a torque frame activates it.
    `used`: expired session numbers, which cannot activate the arm; shared by all sessions.
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
        # Contents of the state frame, and what acts on the model.
        self.controller = 0
        """Session number of the accepted controller, sent in every state frame; 0: none."""
        self.cycle = 0
        """Number of the last state frame."""
        self.echoed = 0
        self.torque = np.zeros(joints)
        self.effort = np.full(joints, np.inf)
        """Largest joint torques (n) [N m]; a command beyond them is rejected."""
        self.braked = True
        # Counters and events.
        self.lost = 0
        """Cycles without a new command since the activation."""
        self.foreign = 0
        """Commands of other controllers."""
        self.excessive = 0
        """Commands beyond `effort`."""
        self.ignored = 0
        """Torque frames outside the state active, and invalid activations."""
        self.total_lost = 0
        self.was_active = False
        self.events: list[tuple[int, str]] = []
        self._echoes = 0
        """State frames sent with the present session number."""
        self._quiet = 0
        """Cycles since the last frame of the controller."""
        self._answered = 0
        """Cycle number that the last command answered."""
        self._stopping = 0
        """Cycles since the start of the ramp-down."""
        self._stopping_torque = np.zeros(joints)

    def again(self) -> ArmLogic:
        """Return the arm for a new session, inactive at its start pose.

        The cycle number continues, and the used session numbers are kept.
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
        """Cycles from the state frame that the last command answered to the last state frame."""
        return (self.cycle - self._answered - 1) % self.cycles if self.was_active else 0

    @property
    def session_is_over(self) -> bool:
        """Whether the arm was active and has no controller any more."""
        return self.was_active and self.controller == 0

    def begin(self, commands: Sequence[Command], velocity: Array) -> None:
        """Start a new cycle; afterwards `torque` and `braked` act until the next cycle.

        `commands`: received since the last state frame. `velocity` (n) [rad/s]: last measured.
        """
        for command in commands:
            self._handle(command)
        # Watchdog: an old command stops the arm.
        if self.life.now is LifeCycle.active:
            age = (self.cycle - self._answered) % self.cycles
            if age >= 1:
                self.lost += 1
                self.total_lost += 1
            if age >= self.watchdog:
                self._stop(f"no command for {age} cycles")
        # Safe stop: the ramp-down needs no controller.
        if self.life.now is LifeCycle.safe_stop and not self.braked:
            elapsed = self._stopping * self.period
            self._stopping += 1
            self.torque = self.ramp.torque(self._stopping_torque, velocity, elapsed)
            if self.ramp.over(velocity, elapsed):
                self._brake()
        # A silent controller loses its session.
        self._quiet += 1
        if self.controller and self._quiet > self.silence:
            self._note(f"controller {self.controller} is silent")
            self.controller = 0
        self.cycle = (self.cycle + 1) % self.cycles
        # The state frame of this cycle contains the session number.
        self._echoes = min(self._echoes + 1, self.watchdog) if self.controller else 0

    def _handle(self, command: Command) -> None:
        if not self._is_from_session(command):
            self.foreign += 1
            return
        self._quiet = 0
        if not (np.abs(command.torque) <= self.effort).all():  # also rejects NaN
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

        A claim starts a session. So does any frame to an implicit arm.
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
        """Reject every later activation with the present session number."""
        if not self.implicit and self.controller not in self.used:
            self.used.append(self.controller)

    def _is_activation(self, command: Command) -> bool:
        """Return whether the frame activates the arm.

        The challenge is a recent state frame of this arm that contained the session number.
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
        # A command that answers an older cycle than the last one was delayed or reordered.
        older = (command.answered - self._answered) % self.cycles >= self.cycles // 2
        if (self.cycle - command.answered) % self.cycles < self.watchdog and not older:
            self.torque = command.torque
            self._answered = self.echoed = command.answered

    def fail(self, reason: str) -> None:
        """Brake and go to fault, because the arm itself has failed."""
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
