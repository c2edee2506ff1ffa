"""What the virtual base robot's own controller decides: whose set points it takes, and what it does when they stop."""

from __future__ import annotations

from collections import deque

import numpy as np

from freeflyer.fmi.component import Array
from freeflyer_adapters.device.device import LifeCycle, State
from freeflyer_adapters.foundation.pose import distance

MOST_USED = 64
"""Publishers that are remembered as used up."""


class BaseLogic:
    """Called every `period` [s]; `watchdog` [calls]: how long set points may stay away, and how old one may be; `jump` [m, rad]: how far the
    first may be from the robot, and each other one from the one before. `used`: publishers (GIDs) that are used up, which outlive this object.

    One publisher is one activation: once *active* has ended it is never obeyed again. Its set points activate the robot when they have
    come for `proof` [calls] as their stamps advance: what was held up on the way, and comes all at once, activates nothing.
    """

    def __init__(
        self,
        *,
        period: float,
        watchdog: int,
        silence: int,
        jump: tuple[float, float],
        used: deque[bytes] | None = None,
        proof: int = 0,
    ) -> None:
        self.proof = proof
        # A proof must be longer than what it allows for.
        self.tolerance = min(watchdog, max(1, proof // 2)) if proof else watchdog
        self.period, self.watchdog, self.silence, self.jump = period, watchdog, silence, jump
        self.used: deque[bytes] = deque(maxlen=MOST_USED) if used is None else used
        self.life = State("the virtual base robot")
        self.life.to(LifeCycle.inactive)
        self.publisher = b""
        """Whose set points are taken while the robot is active."""
        self.position, self.orientation, self.velocity = (
            np.zeros(3),
            np.array([0.0, 0.0, 0.0, 1.0]),
            np.zeros(6),
        )
        """The set point that the robot is given (its own frame is I)."""
        self.refused = 0
        self.was_active = False
        self.events: list[tuple[int, str]] = []
        self._calls = 0
        self._heard = 0
        self._candidate = (b"", 0.0, 0, 0)
        """A publisher that may activate the robot, the stamp of its first set point [s], and the calls in which that and the last came."""

    @property
    def session_is_over(self) -> bool:
        return self.was_active and self._calls - self._heard > self.silence

    def hold(self, position: Array, orientation: Array) -> None:
        """Stay at a pose, without velocity."""
        self.position, self.orientation, self.velocity = (
            position.copy(),
            orientation.copy(),
            np.zeros(6),
        )

    def take(
        self,
        position: Array,
        orientation: Array,
        velocity: Array,
        pose: tuple[Array, Array],
        publisher: bytes = b"?",
        delay: float = 0.0,
        stamp: float = 0.0,
    ) -> bool | None:
        """A set point of this stamp [s], which came `delay` [s] late; `pose` is where the robot is. Whether it is followed; None: not
        yet, its publisher's have not come for long enough.
        """
        finite = (
            np.isfinite(position).all()
            and np.isfinite(orientation).all()
            and np.isfinite(velocity).all()
        )
        if not finite or not 0.98 < float(orientation @ orientation) < 1.02:
            self.refused += 1
            return False
        if delay > self.watchdog * self.period:
            self.refused += 1
            return False
        if self.life.now is LifeCycle.active:
            step = distance(position, orientation, self.position, self.orientation)
            if publisher != self.publisher or any(
                gap > most for gap, most in zip(step, self.jump, strict=True)
            ):
                self.refused += 1
                return False
        else:
            activated = self._is_activated(position, orientation, pose, publisher, stamp)
            if not activated:
                self.refused += activated is not None
                return activated
        self.position, self.orientation, self.velocity = (
            position.copy(),
            orientation.copy(),
            velocity.copy(),
        )
        self._heard = self._calls
        return True

    def refuse(self, publisher: bytes) -> None:
        """A publisher that has sent while another one was obeyed: it is no new activation when that one ends."""
        if publisher != self.publisher and publisher not in self.used:
            self.used.append(publisher)

    def _is_activated(
        self,
        position: Array,
        orientation: Array,
        pose: tuple[Array, Array],
        publisher: bytes,
        stamp: float,
    ) -> bool | None:
        if publisher in self.used:
            return False
        far = distance(position, orientation, *pose)
        if any(gap > most for gap, most in zip(far, self.jump, strict=True)):
            if not self.refused:
                self._note(
                    f"a first set point {far[0]:.4f} m and {far[1]:.4f} rad away was refused"
                )
            return False
        if not self._comes_in_time(publisher, stamp):
            return None
        if self.life.now is LifeCycle.safe_stop:
            self._to(LifeCycle.inactive, "a new publisher's set points came")
        self._to(LifeCycle.active, "set points came")
        self.publisher, self.was_active = publisher, True
        return True

    def _comes_in_time(self, publisher: bytes, stamp: float) -> bool:
        """Whether this publisher's set points have come for long enough as their stamps advance."""
        candidate, first, call, last = self._candidate
        passed = self._calls - call
        agrees = abs(stamp - first - passed * self.period) <= self.tolerance * self.period
        if candidate != publisher or not agrees or self._calls - last > self.tolerance:
            first, call, passed = stamp, self._calls, 0
        self._candidate = (publisher, first, call, self._calls)
        return passed >= self.proof

    def tick(self) -> None:
        """Once every servo cycle, after what came was taken."""
        self._calls += 1
        if self.life.now is LifeCycle.active and self._calls - self._heard > self.watchdog:
            self._to(
                LifeCycle.safe_stop,
                f"no set point for {self.watchdog * self.period:g} s; it holds its place",
            )
            self.velocity = np.zeros(6)

    def _to(self, following: LifeCycle, reason: str) -> None:
        if self.life.now is LifeCycle.active:
            self.used.append(self.publisher)
            self.publisher = b""
        self._note(f"{self.life.now.name} -> {following.name}: {reason}")
        self.life.to(following)

    def _note(self, event: str) -> None:
        self.events.append((self._calls, event))
