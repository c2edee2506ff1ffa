"""Conversion between the raw numbers of the drives and SI units at the joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from freeflyer.fmi.component import Array

MOST_RAW_TORQUE = 0x7FFF


@dataclass(frozen=True, kw_only=True)
class Motor:
    """Motor, encoder and gear of one joint, as in the objects of the drive.

    `rated_torque`: at the motor [N m] (6076h); `encoder_resolution`: increments per motor
    revolution (608Fh); `gear_ratio`: motor revolutions per joint revolution (6091h);
    `velocity_scale`: units of 606Ch per increment per second.
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
        """One unit of 6071h and 6077h (per mille of rated torque) at the joint [N m]."""
        return self.joint_torque / 1000.0

    @property
    def position_step(self) -> float:
        """One unit of 6064h (an increment) at the joint [rad]."""
        return 2.0 * np.pi / (self.encoder_resolution * self.gear_ratio)


class Scaling:
    """Scales of all joints: N m, rad and rad/s per raw unit, shape (n)."""

    def __init__(self, motors: Sequence[Motor]) -> None:
        self.torque_step = np.array([m.torque_step for m in motors])
        self.position_step = np.array([m.position_step for m in motors])
        self.velocity_step = np.array([m.position_step / m.velocity_scale for m in motors])
        self._left = np.zeros(len(motors))

    def reset(self) -> None:
        """Discard the rounding errors of earlier cycles."""
        self._left[:] = 0.0

    def raw_torque(self, torque: Array) -> Array:
        """Return joint torques, shape (n) [N m], in whole raw units.

        The rounding error is added to the torque of the next cycle, so that the mean is exact. The
        torques of a slow motion are only a few units.
        """
        wanted = torque / self.torque_step + self._left
        raw: Array = np.minimum(np.maximum(np.rint(wanted), -MOST_RAW_TORQUE), MOST_RAW_TORQUE)
        self._left = np.minimum(np.maximum(wanted - raw, -0.5), 0.5)
        return raw
