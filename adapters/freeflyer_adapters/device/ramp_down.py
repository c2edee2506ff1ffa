"""The damped ramp-down: how an arm under torque control is brought to rest, by the host or by its own watchdog."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freeflyer.fmi.component import Array

AT_REST = 0.01
"""Joint speed [rad/s] at which the brakes may be engaged before the time is over."""


@dataclass(frozen=True, kw_only=True)
class RampDown:
    """From the last torque to none in `time` [s], with `damping` [N m s/rad] against the joint speeds all the while."""

    time: float
    damping: float

    def torque(self, last: Array, velocity: Array, elapsed: float) -> Array:
        """(n) [N m]: `last` (n) is what acted before, `velocity` (n) [rad/s] what is measured, `elapsed` [s] since the begin."""
        left = max(0.0, 1.0 - elapsed / self.time) if self.time > 0.0 else 0.0
        return left * last - self.damping * np.nan_to_num(velocity)

    def over(self, velocity: Array, elapsed: float) -> bool:
        """Whether to brake: at rest after the ramp, or after twice its time in any case."""
        return elapsed >= self.time and (
            bool((np.abs(velocity) < AT_REST).all()) or elapsed >= 2.0 * self.time
        )
