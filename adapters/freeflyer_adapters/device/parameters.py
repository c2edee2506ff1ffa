"""Settings of a device, from the table `[devices.NAME.parameters]` of a scenario.

A setting has a default, a unit and an effect. Settings are ports, like the parameters of an FMU.
Therefore units, references ("=COMPONENT.PARAMETER") and errors are handled as for an FMU.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from freeflyer.fmi.component import Array, Port
from freeflyer_adapters.foundation.errors import DeviceError


@dataclass(frozen=True, kw_only=True)
class Setting:
    """One setting of a device.

    `effect`: if the setting is a limit, what happens when the limit is exceeded.

    - "clips": the command is limited to the allowed range. Limited commands are counted and
      reported.
    - "stops": the loop stops.
    - "refuses": the activation is rejected.
    - Empty text: the setting is not a limit.

    `per_joint`: whether the setting has a separate value for each joint. `whole`: whether only
    whole numbers are allowed.
    """

    name: str
    default: tuple[float, ...]
    unit: str | None
    description: str
    effect: str = ""
    per_joint: bool = False
    boolean: bool = False
    above: float | None = 0.0
    """Exclusive lower bound; None: no bound."""
    least: float | None = None
    """Inclusive lower bound, or None. If this bound is given, `above` is ignored."""
    whole: bool = False
    most: float = 1e6
    """Inclusive upper bound of the absolute value."""

    def check(self, device: str, values: Array) -> None:
        """Check `values`. Raises DeviceError if a value is out of range.

        The message contains the name, the value and the unit.
        """
        for value in values:
            unit = f" {self.unit}" if self.unit and " " not in self.unit else ""
            if self.whole and value != int(value):
                raise DeviceError(f"{device}.{self.name} is {value:g}; a whole number is expected")
            if self.least is not None and not self.least <= value:
                raise DeviceError(
                    f"{device}.{self.name} is {value:g}{unit}; {self.least:g}{unit} or more is expected"
                )
            if self.least is None and self.above is not None and not self.above < value:
                raise DeviceError(
                    f"{device}.{self.name} is {value:g}{unit}; more than {self.above:g}{unit} is expected"
                )
            if not abs(value) <= self.most:
                raise DeviceError(
                    f"{device}.{self.name} is {value:g}{unit}; at most {self.most:g} is expected"
                )

    def port(self, joints: int) -> Port:
        start = self.default * joints if self.per_joint else self.default
        return Port(
            name=self.name,
            size=len(start),
            causality="parameter",
            units=(self.unit,) * len(start)
            if self.unit is None or " " not in self.unit
            else tuple(self.unit.split()),
            start=start,
            settable=True,
            boolean=self.boolean,
        )


def check(device: str, settings: Sequence[Setting], values: Mapping[str, Array]) -> None:
    """Check all settings. Raises DeviceError if a setting is out of range."""
    for setting in settings:
        setting.check(device, values[setting.name])


def ports(settings: Sequence[Setting], joints: int = 0) -> list[Port]:
    return [setting.port(joints) for setting in settings]


def arm_ports(joints: int, settings: Sequence[Setting]) -> dict[str, Port]:
    """Return the ports of an arm: settings, torque command and measurements."""
    units = {"joint_position": "rad", "joint_velocity": "rad/s", "joint_torque": "N.m"}
    signals = [
        Port(name="joint_torque_command", size=joints, causality="input", units=("N.m",) * joints),
        *(
            Port(name=name, size=joints, causality="output", units=(unit,) * joints, sampled=True)
            for name, unit in units.items()
        ),
    ]
    return {port.name: port for port in (*ports(settings, joints), *signals)}


ARM = (
    Setting(name="period", most=1.0, default=(0.001,), unit="s", description="Period of the arm's state frames. This is also the communication step of the device"),
    Setting(name="joint_effort_limit", default=(10.0,), per_joint=True, unit="N.m", effect="clips",
            description="Largest commanded joint torque"),
    Setting(name="torque_rate_limit", default=(1000.0,), per_joint=True, unit="N.m/s", effect="clips",
            description="Largest rate of commanded joint torque. The default is the limit of libfranka (1 kN m/s)"),
    Setting(name="joint_velocity_limit", default=(1.0,), per_joint=True, unit="rad/s", effect="stops",
            description="Largest measured joint speed"),
    Setting(name="joint_lower_limit", above=None, default=(-np.pi,), per_joint=True, unit="rad", effect="stops",
            description="Smallest measured joint position"),
    Setting(name="joint_upper_limit", above=None, default=(np.pi,), per_joint=True, unit="rad", effect="stops",
            description="Largest measured joint position"),
    Setting(name="joint_limit_margin", least=0.0, most=1.0, default=(0.02,), unit="rad", effect="stops",
            description="Margin at the ends of the joint range. The loop stops if a joint is within this margin"),
    Setting(name="state_age_limit", most=60.0, default=(0.02,), unit="s", effect="stops",
            description="Largest age of the last accepted state frame"),
    Setting(name="lost_consecutive", whole=True, default=(20.0,), unit=None, effect="stops",
            description="Number of consecutive lost cycles at which the loop stops (libfranka: 20)"),
    Setting(name="lost_in_window", whole=True, least=0.0, default=(0.0,), unit=None, effect="stops",
            description="Number of lost cycles within `window` at which the loop stops; 0: no limit"),
    Setting(name="window", most=60.0, default=(0.2,), unit="s", description="Duration of the window of `lost_in_window`"),
    Setting(name="watchdog_cycles", whole=True, most=1e5, default=(4.0,), unit=None, effect="stops",
            description="Watchdog of the arm: number of cycles without a command after which the arm stops by itself. If the loop is delayed for longer, the loop stops as well"),
    Setting(name="start_joint_position", above=None, default=(0.0,), per_joint=True, unit="rad",
            description="Expected joint positions at activation"),
    Setting(name="start_tolerance", default=(0.02,), unit="rad", effect="refuses",
            description="Largest deviation of a joint from `start_joint_position`"),
    Setting(name="ramp_down_time", most=60.0, default=(0.25,), unit="s", description="Damped ramp-down: time until the torque is zero"),
    Setting(name="ramp_down_damping", least=0.0, most=1e4, default=(5.0,), unit="N.m.s/rad", description="Damped ramp-down: damping of the joint speeds"),
    Setting(name="configure_timeout", most=3600.0, default=(3.0,), unit="s", description="Longest wait for the first response of the arm"),
)  # fmt: skip

BASE = (
    Setting(name="period", most=1.0, default=(0.001,), unit="s", description="Communication step: period at which the host reads the latest sample"),
    Setting(name="cycle", most=1.0, default=(0.004,), unit="s", description="Period of the set points and measurements"),
    Setting(name="workspace_lower", above=None, default=(-0.5, -0.5, -0.5), unit="m", effect="stops", description="Lower limit of the set-point position"),
    Setting(name="workspace_upper", above=None, default=(0.5, 0.5, 0.5), unit="m", effect="stops", description="Upper limit of the set-point position"),
    Setting(name="velocity_limit", default=(0.2, 0.5), unit="m/s rad/s", effect="stops", description="Largest set-point speeds"),
    Setting(name="step_limit", default=(0.002, 0.005), unit="m rad", effect="stops",
            description="Largest change of the set point from one cycle to the next"),
    Setting(name="following_error_limit", default=(0.01, 0.02), unit="m rad", effect="stops",
            description="Largest distance of the measured pose from the set point"),
    Setting(name="age_limit", most=60.0, default=(0.02,), unit="s", effect="stops", description="Largest age of the last accepted sample"),
    Setting(name="lost_consecutive", whole=True, default=(2.0,), unit=None, effect="stops",
            description="Number of consecutive lost cycles at which the loop stops (KUKA's external control: 2)"),
    Setting(name="lost_in_window", whole=True, least=0.0, default=(3.0,), unit=None, effect="stops",
            description="Number of lost cycles within `window` at which the loop stops; 0: no limit"),
    Setting(name="window", most=60.0, default=(0.2,), unit="s", description="Duration of the window of `lost_in_window`"),
    Setting(name="watchdog", most=60.0, default=(0.02,), unit="s", effect="stops",
            description="Watchdog of the base: time without a set point after which the base holds its position. If the loop is delayed for longer, the loop stops"),
    Setting(name="start_position", above=None, default=(0.0, 0.0, 0.0), unit="m", description="Expected base position at activation"),
    Setting(name="start_orientation", above=None, default=(0.0, 0.0, 0.0, 1.0), unit="1", description="Expected base orientation at activation, quaternion x, y, z, w"),
    Setting(name="start_tolerance", default=(0.005, 0.01), unit="m rad", effect="refuses",
            description="Largest deviation of the base from `start_position` and `start_orientation`"),
    Setting(name="approach", above=None, boolean=True, default=(0.0,), unit=None, description="Whether to move the base to the start pose by a ramp if its deviation is larger than `start_tolerance`. The arm stays braked"),
    Setting(name="approach_speed", default=(0.02, 0.05), unit="m/s rad/s", description="Speeds of the approach ramp. A deviation within `start_tolerance` is corrected with the same speeds"),
    Setting(name="configure_timeout", most=3600.0, default=(3.0,), unit="s", description="Longest wait for the first response of the base"),
)  # fmt: skip
