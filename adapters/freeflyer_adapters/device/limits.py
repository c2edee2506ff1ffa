"""Limits of the commands and of the measurements of a device.

This module reads no clock and sends nothing. There are two kinds of limits. A clamping limit
reduces a command to the allowed range, and counts the reduced commands. If a stopping limit is
exceeded, a method returns the reason to stop, with the value and the unit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

from freeflyer.fmi.component import Array
from freeflyer_adapters.foundation.pose import distance


class ArmLimits:
    """Limits of one arm.

    `settings`: values of `device.parameters.ARM`. `cycle`: period of the commands [s].
    """

    def __init__(self, settings: Mapping[str, Array], cycle: float) -> None:
        self.effort = np.array(settings["joint_effort_limit"])
        self.change = np.array(settings["torque_rate_limit"]) * cycle
        self.velocity = np.array(settings["joint_velocity_limit"])
        margin = float(settings["joint_limit_margin"][0])
        self.lower, self.upper = (
            settings["joint_lower_limit"] + margin,
            settings["joint_upper_limit"] - margin,
        )
        self.acted: Counter[str] = Counter(joint_effort_limit=0, torque_rate_limit=0)

    def command(self, wanted: Array, before: Array) -> tuple[Array, str | None]:
        """Clamp the torque `wanted` (n) [N m]. n: number of joints.

        `before` (n) [N m]: torque of the last cycle. Return the torque to send, and a reason to
        stop or None.
        """
        if not np.isfinite(wanted).all():
            return (
                before,
                f"the commanded joint torque is {_listed(wanted)} N m; finite numbers are expected",
            )
        # For small arrays, np.minimum and np.maximum are several times faster than np.clip.
        held = np.minimum(np.maximum(wanted, -self.effort), self.effort)
        if (held != wanted).any():
            self.acted["joint_effort_limit"] += 1
        slewed = np.minimum(np.maximum(held, before - self.change), before + self.change)
        if (slewed != held).any():
            self.acted["torque_rate_limit"] += 1
        # Clamp to the effort limit again, because `before` may be outside the effort limit.
        return np.minimum(np.maximum(slewed, -self.effort), self.effort), None

    def measured(self, position: Array, velocity: Array) -> str | None:
        """Check measured positions (n) [rad] and velocities (n) [rad/s] of the joints.

        Return a reason to stop, or None.
        """
        # NaN is rejected as well, because every comparison with NaN is False.
        if not ((np.abs(velocity) <= self.velocity).all()):
            joint = int(np.argmax(np.nan_to_num(np.abs(velocity) / self.velocity, nan=np.inf)))
            return f"joint {joint + 1} moves at {velocity[joint]:.4g} rad/s, its limit is {self.velocity[joint]:.4g} rad/s"
        if not ((position >= self.lower) & (position <= self.upper)).all():
            beyond = np.nan_to_num(
                np.maximum(self.lower - position, position - self.upper), nan=np.inf
            )
            joint = int(np.argmax(beyond))
            return f"joint {joint + 1} is at {position[joint]:.4g} rad, its range is {self.lower[joint]:.4g} to {self.upper[joint]:.4g} rad"
        return None

    def start(self, values: Mapping[str, Array]) -> str | None:
        """Return the reason why the arm must not be activated in its present position, or None.

        Each joint must be close to the start position of the scenario.
        """
        position, start = values["joint_position"], values["start_joint_position"]
        tolerance = float(values["start_tolerance"][0])
        gap = np.abs(position - start)
        if (gap <= tolerance).all():
            return None
        j = int(np.argmax(gap))
        return (
            f"joint {j + 1} is at {position[j]:.4f} rad, the scenario starts at {start[j]:.4f} rad, and the largest allowed "
            f"distance is {tolerance:g} rad: move the arm to the start position"
        )

    def report(self) -> dict[str, float]:
        """Return how often each limit has clamped a command."""
        return {f"{name}_acted": float(count) for name, count in self.acted.items()}


class BaseLimits:
    """Limits of one base robot. `settings`: values of `device.parameters.BASE`."""

    def __init__(self, settings: Mapping[str, Array]) -> None:
        self.lower, self.upper = (
            np.array(settings["workspace_lower"]),
            np.array(settings["workspace_upper"]),
        )
        self.speed = np.array(settings["velocity_limit"])
        self.step = np.array(settings["step_limit"])
        self.following = np.array(settings["following_error_limit"])

    def setpoint(
        self,
        position: Array,
        orientation: Array,
        velocity: Array,
        before: tuple[Array, Array] | None,
    ) -> str | None:
        """Check a set point. Return the reason why it must not be sent, or None.

        `position` (3) [m]. `orientation` (4): quaternion x, y, z, w. `velocity` (6) [m/s, rad/s].
        `before`: position and orientation of the previous set point, or None.
        """
        if not (
            np.isfinite(position).all()
            and np.isfinite(orientation).all()
            and np.isfinite(velocity).all()
        ):
            return f"the base's set point is {_listed([*position, *orientation, *velocity])}; finite numbers are expected"
        if not 0.9 < float(orientation @ orientation) < 1.1:
            return f"the base's orientation set point has the squared norm {orientation @ orientation:.3g}; 1 is expected"
        if not ((position >= self.lower) & (position <= self.upper)).all():
            return f"the base's set point {_listed(position)} m is outside the workspace {_listed(self.lower)} to {_listed(self.upper)} m"
        for part, limit, unit in (
            (velocity[:3], self.speed[0], "m/s"),
            (velocity[3:], self.speed[1], "rad/s"),
        ):
            size = float(np.linalg.norm(part))
            if size > limit:
                return f"the base's set point moves at {size:.4g} {unit}, its limit is {limit:.4g} {unit}"
        if before is not None:
            for size, limit, unit in zip(
                distance(position, orientation, *before), self.step, ("m", "rad"), strict=True
            ):
                if size > limit:
                    return f"the base's set point jumps by {size:.4g} {unit} in one cycle, its limit is {limit:.4g} {unit}"
        return None

    def measured(
        self, position: Array, orientation: Array, setpoint: tuple[Array, Array]
    ) -> str | None:
        """Check the measured pose. Return a reason to stop, or None.

        `setpoint`: position and orientation of the set point.
        """
        if not (np.isfinite(position).all() and np.isfinite(orientation).all()):
            return f"the base's measured pose is {_listed([*position, *orientation])}; finite numbers are expected"
        for size, limit, unit in zip(
            distance(position, orientation, *setpoint), self.following, ("m", "rad"), strict=True
        ):
            if size > limit:
                return f"the base is {size:.4g} {unit} from its set point, the limit is {limit:.4g} {unit}"
        return None


def _listed(numbers: Array | list[float]) -> str:
    return "[" + ", ".join(f"{float(x):.4g}" for x in numbers) + "]"
