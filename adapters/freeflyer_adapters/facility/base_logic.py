"""Controller of the virtual base robot: selection of the publisher, life cycle and watchdog."""

from __future__ import annotations

from collections import deque

import numpy as np

from freeflyer.fmi.component import Array
from freeflyer_adapters.device.device import LifeCycle, State
from freeflyer_adapters.foundation.pose import distance

MOST_USED = 64
"""Maximum number of expired publishers that are stored (see `BaseLogic`)."""


class BaseLogic:
    """State machine of the base robot's controller. `tick` is called every `period` [s].

    The unit [calls] is the time between two calls of `tick`.

    `watchdog` [calls]: after this time without a set point, the robot stops and holds its pose. A
    set point that is older than this time is rejected.
    `silence` [calls]: after this time without a set point, the session has ended.
    `proof` [calls]: duration of the test of a new publisher.
    `jump`: a distance [m] and an angle [rad]. They limit the step from the pose of the robot to the
    first set point, and the step from one accepted set point to the next.
    `used`: GIDs of expired publishers. All sessions share this list. A GID identifies a publisher.

    A publisher can activate the robot only once. It expires when the robot leaves the state active.
    Before the activation, the publisher is tested.
    In the test, set points must arrive at the rate of their time stamps. Delayed set points that
    arrive in a burst do not pass the test, so they do not activate the robot.
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
        # Permitted time error of a set point in the test [calls]. It must be shorter than the
        # test.
        self.tolerance = min(watchdog, max(1, proof // 2)) if proof else watchdog
        self.period, self.watchdog, self.silence, self.jump = period, watchdog, silence, jump
        self.used: deque[bytes] = deque(maxlen=MOST_USED) if used is None else used
        self.life = State("the virtual base robot")
        self.life.to(LifeCycle.inactive)
        self.publisher = b""
        """GID of the accepted publisher. Empty if the robot is not in the state active."""
        self.position, self.orientation, self.velocity = (
            np.zeros(3),
            np.array([0.0, 0.0, 0.0, 1.0]),
            np.zeros(6),
        )
        """Last accepted set point or held pose, in the inertial frame I."""
        self.refused = 0
        self.was_active = False
        self.events: list[tuple[int, str]] = []
        self._calls = 0
        self._accepted_at = 0
        """Number of the call in which the last set point was accepted."""
        self._candidate = (b"", 0.0, 0, 0)
        """Data of the publisher that is being tested.

        The data are the GID, the time stamp of the first set point [s], and the numbers of the
        calls in which the first set point and the last set point arrived."""

    @property
    def session_is_over(self) -> bool:
        """Whether the robot was active and has accepted no set point for `silence` calls."""
        return self.was_active and self._calls - self._accepted_at > self.silence

    def hold(self, position: Array, orientation: Array) -> None:
        """Set a pose with zero velocity as the set point."""
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
        """Handle a set point. Return True if the set point is accepted, False if it is rejected.

        Return None while the test of the publisher is incomplete. `position`, `orientation` and
        `velocity`: the set point, in the inertial frame I. `pose`: present position and orientation
        of the robot. `publisher`: GID of the publisher. `delay` [s]: age of the set point.
        `stamp` [s]: time stamp of the set point.
        """
        # Reject invalid values and old set points.
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
        # In the state active, reject other publishers, and set points that jump.
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
        self._accepted_at = self._calls
        return True

    def refuse(self, publisher: bytes) -> None:
        """Mark `publisher` as expired: it sent set points in the session of another publisher."""
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
                    f"the first set point was rejected: the distance to the pose of the robot is {far[0]:.4f} m and {far[1]:.4f} rad"
                )
            return False
        if not self._comes_in_time(publisher, stamp):
            return None
        if self.life.now is LifeCycle.safe_stop:
            self._to(LifeCycle.inactive, "set points of a new publisher arrived")
        self._to(LifeCycle.active, "set points arrived")
        self.publisher, self.was_active = publisher, True
        return True

    def _comes_in_time(self, publisher: bytes, stamp: float) -> bool:
        """Return whether this publisher has passed the test.

        The test starts again if a set point arrives at a wrong time, or from another publisher.
        """
        candidate, first, call, last = self._candidate
        passed = self._calls - call
        agrees = abs(stamp - first - passed * self.period) <= self.tolerance * self.period
        if candidate != publisher or not agrees or self._calls - last > self.tolerance:
            first, call, passed = stamp, self._calls, 0
        self._candidate = (publisher, first, call, self._calls)
        return passed >= self.proof

    def tick(self) -> None:
        """Advance by one period. Before this call, pass the set points of this period to `take`."""
        self._calls += 1
        if self.life.now is LifeCycle.active and self._calls - self._accepted_at > self.watchdog:
            self._to(
                LifeCycle.safe_stop,
                f"no set point for {self.watchdog * self.period:g} s; the robot holds its pose",
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
