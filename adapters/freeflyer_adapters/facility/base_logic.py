"""What the virtual base robot's own controller decides: whose set points it takes, and what it does when they stop."""

from __future__ import annotations

import numpy as np

from freeflyer.component import Array
from freeflyer_adapters.device import LifeCycle, State
from freeflyer_adapters.pose import distance


class BaseLogic:
    """Called every `period` [s]; `watchdog` [calls]: how long set points may stay away before the base holds; `jump` [m, rad]: how far the first
    may be from the robot, and each other one from the one before."""

    def __init__(self, *, period: float, watchdog: int, silence: int, jump: tuple[float, float]) -> None:
        self.period, self.watchdog, self.silence, self.jump = period, watchdog, silence, jump
        self.life = State("the virtual base robot")
        self.life.to(LifeCycle.inactive)
        self.position, self.orientation, self.velocity = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(6)
        """The set point that the robot is given (its own frame is I)."""
        self.refused = 0
        self.was_active = False
        self.events: list[tuple[int, str]] = []
        self._calls = 0
        self._heard = 0

    @property
    def session_is_over(self) -> bool:
        return self.was_active and self._calls - self._heard > self.silence

    def hold(self, position: Array, orientation: Array) -> None:
        """Stay at a pose, without velocity."""
        self.position, self.orientation, self.velocity = position.copy(), orientation.copy(), np.zeros(6)

    def take(self, position: Array, orientation: Array, velocity: Array, pose: tuple[Array, Array]) -> bool:
        """A set point that came; `pose` is where the robot is. Whether it is followed."""
        finite = np.isfinite(position).all() and np.isfinite(orientation).all() and np.isfinite(velocity).all()
        if not finite or not 0.98 < float(orientation @ orientation) < 1.02:
            self.refused += 1
            return False
        if self.life.now is LifeCycle.active:
            step = distance(position, orientation, self.position, self.orientation)
            if any(gap > most for gap, most in zip(step, self.jump, strict=True)):
                self.refused += 1
                return False
        else:
            far = distance(position, orientation, *pose)
            if any(gap > most for gap, most in zip(far, self.jump, strict=True)):
                if not self.refused:
                    self._note(f"a first set point {far[0]:.4f} m and {far[1]:.4f} rad away was refused")
                self.refused += 1
                return False
            if self.life.now is LifeCycle.safe_stop:
                self._to(LifeCycle.inactive, "set points came again")
            self._to(LifeCycle.active, "set points came")
            self.was_active = True
        self.position, self.orientation, self.velocity = position.copy(), orientation.copy(), velocity.copy()
        self._heard = self._calls
        return True

    def tick(self) -> None:
        """Once every servo cycle, after what came was taken."""
        self._calls += 1
        if self.life.now is LifeCycle.active and self._calls - self._heard > self.watchdog:
            self._to(LifeCycle.safe_stop, f"no set point for {self.watchdog * self.period:g} s; it holds its place")
            self.velocity = np.zeros(6)

    def _to(self, following: LifeCycle, reason: str) -> None:
        self._note(f"{self.life.now.name} -> {following.name}: {reason}")
        self.life.to(following)

    def _note(self, event: str) -> None:
        self.events.append((self._calls, event))
