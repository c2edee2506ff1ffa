"""Graded stop of one torque-controlled arm: damped ramp-down of the torque, then the brakes.

The host and the watchdogs of the virtual arms use this module.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from freeflyer.fmi.component import Array

AT_REST = 0.01
"""Joint speed [rad/s] below which the arm counts as at rest."""


@dataclass(frozen=True, kw_only=True)
class RampDown:
    """Ramp of the torque to zero, with damping of the joint speeds.

    `time` [s]: duration of the ramp. `damping` [N m s/rad]: damping of each joint.
    """

    time: float
    damping: float

    @classmethod
    def of(cls, settings: Mapping[str, Array]) -> RampDown:
        """Create the ramp-down from an arm's settings."""
        time, damping = (float(settings[f"ramp_down_{key}"][0]) for key in ("time", "damping"))
        return cls(time=time, damping=damping)

    def torque(self, last: Array, velocity: Array, elapsed: float) -> Array:
        """Return the torque (n) [N m] at the time `elapsed` [s] after the start of the ramp.

        `last` (n) [N m]: torque at the start of the ramp. `velocity` (n) [rad/s]: measured joint
        velocities.
        """
        left = max(0.0, 1.0 - elapsed / self.time) if self.time > 0.0 else 0.0
        return left * last - self.damping * np.nan_to_num(velocity)

    def over(self, velocity: Array, elapsed: float) -> bool:
        """Return whether the brakes must engage.

        The brakes must engage after the ramp if the arm is at rest. After twice the duration of the
        ramp, the brakes must always engage.
        """
        return elapsed >= self.time and (
            bool((np.abs(velocity) < AT_REST).all()) or elapsed >= 2.0 * self.time
        )
