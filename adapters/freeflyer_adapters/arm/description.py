"""Comparison of an arm's description frame with the robot of the scenario."""

from __future__ import annotations

from collections.abc import Mapping

from freeflyer.fmi.component import Array
from freeflyer_adapters.arm.frames import LIMIT_ROLES
from freeflyer_adapters.can.frame import Frame
from freeflyer_adapters.device import settings as all_settings
from freeflyer_adapters.device.device import DeviceError

MAY_BE_NARROWER = ("joint_velocity_limit", "joint_effort_limit")
UNITS = {setting.name: setting.unit for setting in all_settings.ARM}


def compare(
    where: str,
    frame: Frame,
    described: Mapping[str, list[float]],
    expected: Mapping[str, Array],
    joints: int,
) -> None:
    """Raise DeviceError, with both values, if they differ by more than the frame's resolution.

    `where`: name of the arm in errors; `described`: values of `frame` by role [SI]; `expected`:
    settings of `freeflyer_adapters.device.settings.ARM`, one value per joint. The speed and torque
    limits of the scenario may be lower than those of the arm. The position limits must be equal, as
    they identify the arm.
    """
    count, period = int(described["joint_count"][0]), float(expected["period"][0])
    if count != joints:
        raise DeviceError(f"{where} has {count} joints, but the scenario's robot has {joints}")
    if "cycle_time" in described and abs(described["cycle_time"][0] - period) > 1e-9:
        raise DeviceError(
            f"{where} has a cycle of {described['cycle_time'][0]:g} s, but the scenario's is {period:g} s"
        )
    for role in LIMIT_ROLES:
        for j, (actual, limit) in enumerate(
            zip(described.get(role, ()), expected[role], strict=False)
        ):
            f = frame.fields[role][j]
            beyond = min(max(float(limit), f.least), f.most) - actual
            if (beyond if role in MAY_BE_NARROWER else abs(beyond)) > f.resolution:
                raise DeviceError(
                    f"{where}: its {role.replace('_', ' ')} of joint {j + 1} is {actual:g} {UNITS[role]}, but the scenario's robot has "
                    f"{float(limit):g} {UNITS[role]}; it is another arm, or one of the two values is wrong"
                )
