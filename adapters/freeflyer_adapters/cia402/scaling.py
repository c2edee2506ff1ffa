"""Raw numbers of the drives and SI at the joints. Torques: per mille of the motor's rated torque, times the gear; positions: increments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from freeflyer.fmi.component import Array

MOST_RAW_TORQUE = 0x7FFF


@dataclass(frozen=True, kw_only=True)
class Motor:
    """One joint's motor, encoder and gear as the drive's objects have them.

    `rated_torque` [N m] at the motor (6076h), `encoder_resolution` increments a turn of the motor (608Fh), `gear_ratio` turns of the
    motor a turn of the joint (6091h), `velocity_scale`: units of 606Ch to one increment a second.
    """

    rated_torque: float
    encoder_resolution: float
    gear_ratio: float
    velocity_scale: float = 1.0

    @property
    def joint_torque(self) -> float:
        """Rated torque at the joint [N m]; the gear is taken to lose nothing."""
        return self.rated_torque * self.gear_ratio

    @property
    def torque_step(self) -> float:
        """One unit of 6071h and 6077h at the joint [N m]."""
        return self.joint_torque / 1000.0

    @property
    def position_step(self) -> float:
        """One unit of 6064h at the joint [rad]."""
        return 2.0 * np.pi / (self.encoder_resolution * self.gear_ratio)


class Scaling:
    """Of all joints."""

    def __init__(self, motors: Sequence[Motor]) -> None:
        self.torque_step = np.array([m.torque_step for m in motors])
        self.position_step = np.array([m.position_step for m in motors])
        self.velocity_step = np.array([m.position_step / m.velocity_scale for m in motors])
        self._left = np.zeros(len(motors))

    def forget(self) -> None:
        """Nothing is carried over."""
        self._left[:] = 0.0

    def raw_torque(self, torque: Array) -> Array:
        """(n) [N m] to whole units. What rounding leaves is added to the next cycle's torque, so that the mean is kept: a unit is a
        thousandth of the rated torque, and the torques of a slow motion are a few of them.
        """
        wanted = torque / self.torque_step + self._left
        raw: Array = np.minimum(np.maximum(np.rint(wanted), -MOST_RAW_TORQUE), MOST_RAW_TORQUE)
        self._left = np.minimum(np.maximum(wanted - raw, -0.5), 0.5)
        return raw
