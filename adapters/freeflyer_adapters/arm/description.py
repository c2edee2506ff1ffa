"""Comparison of an arm's description frame with the robot of the scenario."""

from __future__ import annotations

from collections.abc import Mapping

from freeflyer.fmi.component import Array
from freeflyer_adapters.arm.frames import LIMIT_ROLES
from freeflyer_adapters.can.frame import Frame
from freeflyer_adapters.device import parameters as device_parameters
from freeflyer_adapters.foundation.errors import DeviceError

MAY_BE_NARROWER = ("joint_velocity_limit", "joint_effort_limit")
UNITS = {setting.name: setting.unit for setting in device_parameters.ARM}


def compare(
    where: str,
    frame: Frame,
    described: Mapping[str, list[float]],
    expected: Mapping[str, Array],
    joints: int,
) -> None:
    """Raise DeviceError if a described value differs from the value in the scenario.

    Differences up to the resolution of the signal are accepted. The speed limits and torque limits
    of the scenario may be lower than the limits of the arm. The position limits must be equal,
    because different position limits indicate a different arm. The error message contains both
    values.

    `where`: name of the arm in error messages. `frame`: the description frame. `described`: the
    values of this frame in SI units, as role -> values. A role is the name of a quantity, see
    `frames.py`.
    `expected`: settings of `freeflyer_adapters.device.parameters.ARM`, one value per joint.
    `joints`: number of joints in the scenario.
    """
    count, period = int(described["joint_count"][0]), float(expected["period"][0])
    if count != joints:
        raise DeviceError(f"{where} has {count} joints, but the scenario's robot has {joints}")
    if "cycle_time" in described and abs(described["cycle_time"][0] - period) > 1e-9:
        raise DeviceError(
            f"{where} has a cycle of {described['cycle_time'][0]:g} s, but the scenario has a cycle of {period:g} s"
        )
    for role in LIMIT_ROLES:
        for j, (actual, limit) in enumerate(
            zip(described.get(role, ()), expected[role], strict=False)
        ):
            f = frame.fields[role][j]
            beyond = min(max(float(limit), f.least), f.most) - actual
            if (beyond if role in MAY_BE_NARROWER else abs(beyond)) > f.resolution:
                raise DeviceError(
                    f"{where}: the {role.replace('_', ' ')} of joint {j + 1} is {actual:g} {UNITS[role]}, but the scenario's robot has "
                    f"{float(limit):g} {UNITS[role]}; this arm is not the scenario's arm, or one of the two values is wrong"
                )
