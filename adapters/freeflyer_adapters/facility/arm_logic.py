"""What the virtual arm's own controller decides in every cycle: whom it obeys, its life cycle, its watchdog.

No clock is read and nothing is sent here: a cycle is a call, at any speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from freeflyer.component import Array
from freeflyer_adapters.arm.frames import Mode
from freeflyer_adapters.device import LifeCycle, State
from freeflyer_adapters.ramp_down import RampDown


@dataclass(frozen=True, kw_only=True)
class Command:
    """One accepted command frame; `torque` (n) [N m]."""

    controller: int
    mode: Mode | None
    answered: int
    torque: Array


class ArmLogic:
    """`watchdog` [cycles]: age of the last command at which the arm goes to safe stop; `silence` [cycles] after which it forgets
    its controller; cycle numbers count modulo `cycles`.
    """

    def __init__(
        self, joints: int, *, cycle: float, watchdog: int, silence: int, ramp: RampDown, cycles: int = 1 << 24
    ) -> None:
        self.cycles = cycles
        self.period, self.watchdog, self.silence, self.ramp = cycle, watchdog, silence, ramp
        self.life = State("the virtual arm")
        self.life.to(LifeCycle.inactive)
        self.controller = 0
        self.cycle = 0
        """Number of the last state frame."""
        self.echoed = 0
        self.torque = np.zeros(joints)
        self.effort = np.full(joints, np.inf)
        """Joint torques (n) [N m] beyond which a command is not used."""
        self.braked = True
        self.lost = 0
        self.strangers = 0
        self.excessive = 0
        """Commands beyond `effort`."""
        self.total_lost = 0
        self.was_active = False
        self.events: list[tuple[int, str]] = []
        self._quiet = 0
        self._answered = 0
        self._stopping = 0
        self._stopping_torque = np.zeros(joints)

    @property
    def command_age(self) -> int:
        """Cycles between the last state frame and the one that the last command answered."""
        return (self.cycle - self._answered - 1) % self.cycles if self.was_active else 0

    @property
    def session_is_over(self) -> bool:
        """An arm that has moved, and whose controller has gone."""
        return self.was_active and self.controller == 0

    def begin(self, commands: Sequence[Command], velocity: Array) -> None:
        """The begin of a new cycle: `commands` came since the last state frame; `velocity` (n) [rad/s] is the last measured one.

        Afterwards `torque` and `braked` are what acts until the next cycle.
        """
        for command in commands:
            self._obey(command)
        if self.life.now is LifeCycle.active:
            age = (self.cycle - self._answered) % self.cycles
            if age >= 1:
                self.lost += 1
                self.total_lost += 1
            if age >= self.watchdog:
                self._stop(f"no command for {age} cycles")
        if self.life.now is LifeCycle.safe_stop and not self.braked:
            elapsed = self._stopping * self.period
            self._stopping += 1
            self.torque = self.ramp.torque(self._stopping_torque, velocity, elapsed)
            if self.ramp.over(velocity, elapsed):
                self._brake()
        self._quiet += 1
        if self.controller and self._quiet > self.silence:
            self._note(f"controller {self.controller} is silent")
            self.controller = 0
        self.cycle = (self.cycle + 1) % self.cycles

    def _obey(self, command: Command) -> None:
        if command.controller == 0 or (self.controller and command.controller != self.controller):
            self.strangers += 1
            return
        if not self.controller:
            self.controller = command.controller
            self._note(f"obeys controller {self.controller}")
        self._quiet = 0
        if not (np.abs(command.torque) <= self.effort).all():  # in this order NaN fails
            self.excessive += 1
            return
        age = (self.cycle - command.answered) % self.cycles
        if command.mode is Mode.reset and self.life.now in (LifeCycle.safe_stop, LifeCycle.fault) and self.braked:
            self._to(LifeCycle.inactive, "reset")
        elif command.mode is Mode.brake and self.life.now in (LifeCycle.active, LifeCycle.safe_stop):
            if self.life.now is LifeCycle.active:
                self._to(LifeCycle.inactive, "brakes commanded")
            self._brake()
        elif command.mode is Mode.torque and age < self.watchdog:
            if self.life.now is LifeCycle.inactive:
                self._to(LifeCycle.active, "commanded")
                self.braked, self.was_active, self.lost = False, True, 0
                self._answered = command.answered
            # One that answers an older cycle than the last one is not used: it came late, or out of order.
            older = (command.answered - self._answered) % self.cycles >= self.cycles // 2
            if self.life.now is LifeCycle.active and not older:
                self.torque = command.torque
                self._answered = self.echoed = command.answered

    def fail(self, reason: str) -> None:
        """The arm itself has failed: brakes, and fault."""
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
        self._note(f"{self.life.now.name} -> {following.name}: {reason}")
        self.life.to(following)

    def _note(self, event: str) -> None:
        self.events.append((self.cycle, event))
