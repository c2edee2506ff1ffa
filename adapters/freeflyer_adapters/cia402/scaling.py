"""Conversion between the raw numbers of the drives and SI units at the joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from freeflyer.fmi.component import Array

MOST_RAW_TORQUE = 0x7FFF


@dataclass(frozen=True, kw_only=True)
class Motor:
    """Motor, encoder and gear of one joint. Numbers such as 6076h are objects of the drive.

    - `rated_torque`: rated torque of the motor [N m] (6076h).
    - `encoder_resolution`: increments per motor revolution (608Fh).
    - `gear_ratio`: motor revolutions per joint revolution (6091h).
    - `velocity_scale`: number of units of 606Ch for a velocity of one increment per second.
    """

    rated_torque: float
    encoder_resolution: float
    gear_ratio: float
    velocity_scale: float = 1.0

    @property
    def joint_torque(self) -> float:
        """Rated torque at the joint [N m], for a gear without losses."""
        return self.rated_torque * self.gear_ratio

    @property
    def torque_step(self) -> float:
        """Torque at the joint [N m] for one unit of 6071h and 6077h.

        One unit is 0.001 of the rated torque of the motor.
        """
        return self.joint_torque / 1000.0

    @property
    def position_step(self) -> float:
        """Angle of the joint [rad] for one unit of 6064h (one increment)."""
        return 2.0 * np.pi / (self.encoder_resolution * self.gear_ratio)


class Scaling:
    """Conversion factors of all joints. n: number of joints.

    The factors are arrays of shape (n), with N m, rad and rad/s per raw unit.
    """

    def __init__(self, motors: Sequence[Motor]) -> None:
        self.torque_step = np.array([m.torque_step for m in motors])
        self.position_step = np.array([m.position_step for m in motors])
        self.velocity_step = np.array([m.position_step / m.velocity_scale for m in motors])
        self._left = np.zeros(len(motors))

    def reset(self) -> None:
        """Discard the rounding errors of earlier cycles."""
        self._left[:] = 0.0

    def raw_torque(self, torque: Array) -> Array:
        """Convert joint torques, shape (n) [N m], to whole raw units.

        The rounding error is added to the torque of the next cycle. Therefore the mean of the sent
        torques is the mean of the wanted torques. This is necessary because the torques of a slow
        motion are only a few raw units.
        """
        wanted = torque / self.torque_step + self._left
        raw: Array = np.minimum(np.maximum(np.rint(wanted), -MOST_RAW_TORQUE), MOST_RAW_TORQUE)
        self._left = np.minimum(np.maximum(wanted - raw, -0.5), 0.5)
        return raw
