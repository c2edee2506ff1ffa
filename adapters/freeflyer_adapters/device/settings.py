"""Numbers that a device can be told in a scenario, `[devices.NAME.parameters]`: each with default, unit and what it does.

They are ports like an FMU's parameters, so that units, references ("=COMPONENT.PARAMETER") and mistakes are handled alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from freeflyer.fmi.component import Array, Port
from freeflyer_adapters.device.device import DeviceError


@dataclass(frozen=True, kw_only=True)
class Setting:
    """`effect`: what happens when a limit is met ("clips", counted and reported, or "stops"); empty for what is no limit."""

    name: str
    default: tuple[float, ...]
    unit: str | None
    description: str
    effect: str = ""
    per_joint: bool = False
    boolean: bool = False
    above: float | None = 0.0
    """Every value is greater than this; None: any."""
    least: float | None = None
    """In place of `above`: every value is this or more."""
    whole: bool = False
    most: float = 1e6

    def check(self, device: str, values: Array) -> None:
        """DeviceError for a value out of range: names, number, unit."""
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
    """Every setting within its range; DeviceError if not."""
    for setting in settings:
        setting.check(device, values[setting.name])


def ports(settings: Sequence[Setting], joints: int = 0) -> list[Port]:
    return [setting.port(joints) for setting in settings]


def arm_ports(joints: int, settings: Sequence[Setting]) -> dict[str, Port]:
    """Of every arm: its settings, what it is told, and what it measures."""
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
    Setting(name="period", most=1.0, default=(0.001,), unit="s", description="Cycle of the arm's state frames, and its communication step"),
    Setting(name="joint_effort_limit", default=(10.0,), per_joint=True, unit="N.m", effect="clips",
            description="Largest commanded joint torque"),
    Setting(name="torque_rate_limit", default=(1000.0,), per_joint=True, unit="N.m/s", effect="clips",
            description="Largest rate of commanded joint torque (1 kN m/s: libfranka's)"),
    Setting(name="joint_velocity_limit", default=(1.0,), per_joint=True, unit="rad/s", effect="stops",
            description="Largest measured joint speed"),
    Setting(name="joint_lower_limit", above=None, default=(-np.pi,), per_joint=True, unit="rad", effect="stops",
            description="Least measured joint position"),
    Setting(name="joint_upper_limit", above=None, default=(np.pi,), per_joint=True, unit="rad", effect="stops",
            description="Largest measured joint position"),
    Setting(name="joint_limit_margin", least=0.0, most=1.0, default=(0.02,), unit="rad", effect="stops",
            description="How far from the ends of the joint range it stops"),
    Setting(name="state_age_limit", most=60.0, default=(0.02,), unit="s", effect="stops",
            description="Largest age of the last accepted state frame"),
    Setting(name="lost_consecutive", whole=True, default=(20.0,), unit=None, effect="stops",
            description="Lost cycles in a row (libfranka: 20)"),
    Setting(name="lost_in_window", whole=True, least=0.0, default=(0.0,), unit=None, effect="stops",
            description="Lost cycles within the window; 0: off"),
    Setting(name="window", most=60.0, default=(0.2,), unit="s", description="Window of lost_in_window"),
    Setting(name="watchdog_cycles", whole=True, most=1e5, default=(4.0,), unit=None, effect="stops",
            description="The arm's own watchdog: cycles without a command after which it stops by itself; a loop that was held up for longer stops"),
    Setting(name="start_joint_position", above=None, default=(0.0,), per_joint=True, unit="rad",
            description="Where the scenario expects the joints at activation"),
    Setting(name="start_tolerance", default=(0.02,), unit="rad", effect="refuses",
            description="Largest distance of a joint from there"),
    Setting(name="ramp_down_time", most=60.0, default=(0.25,), unit="s", description="Damped ramp-down: time until the torque is gone"),
    Setting(name="ramp_down_damping", least=0.0, most=1e4, default=(5.0,), unit="N.m.s/rad", description="Damped ramp-down: torque against joint speed"),
    Setting(name="configure_timeout", most=3600.0, default=(3.0,), unit="s", description="How long the arm may take to answer at first"),
)  # fmt: skip

BASE = (
    Setting(name="period", most=1.0, default=(0.001,), unit="s", description="Communication step: how often the freshest sample is read"),
    Setting(name="cycle", most=1.0, default=(0.004,), unit="s", description="Cycle of set points and measurements"),
    Setting(name="workspace_lower", above=None, default=(-0.5, -0.5, -0.5), unit="m", effect="stops", description="Least set-point position"),
    Setting(name="workspace_upper", above=None, default=(0.5, 0.5, 0.5), unit="m", effect="stops", description="Largest set-point position"),
    Setting(name="velocity_limit", default=(0.2, 0.5), unit="m/s rad/s", effect="stops", description="Largest set-point speeds"),
    Setting(name="step_limit", default=(0.002, 0.005), unit="m rad", effect="stops",
            description="Largest change of the set point from one cycle to the next"),
    Setting(name="following_error_limit", default=(0.01, 0.02), unit="m rad", effect="stops",
            description="Largest distance of the measured pose from the set point"),
    Setting(name="age_limit", most=60.0, default=(0.02,), unit="s", effect="stops", description="Largest age of the last accepted sample"),
    Setting(name="lost_consecutive", whole=True, default=(2.0,), unit=None, effect="stops",
            description="Lost cycles in a row (KUKA's external control: 2)"),
    Setting(name="lost_in_window", whole=True, least=0.0, default=(3.0,), unit=None, effect="stops", description="Lost cycles within the window; 0: off"),
    Setting(name="window", most=60.0, default=(0.2,), unit="s", description="Window of lost_in_window"),
    Setting(name="watchdog", most=60.0, default=(0.02,), unit="s", effect="stops",
            description="The base's own watchdog: time without a set point after which it holds its place; a loop that was held up for longer stops"),
    Setting(name="start_position", above=None, default=(0.0, 0.0, 0.0), unit="m", description="Where the scenario expects the base at activation"),
    Setting(name="start_orientation", above=None, default=(0.0, 0.0, 0.0, 1.0), unit="1", description="Its orientation there, quaternion x, y, z, w"),
    Setting(name="start_tolerance", default=(0.005, 0.01), unit="m rad", effect="refuses",
            description="Largest distance of the base from there"),
    Setting(name="approach", above=None, boolean=True, default=(0.0,), unit=None, description="A base further away is brought there by a ramp, arm braked"),
    Setting(name="approach_speed", default=(0.02, 0.05), unit="m/s rad/s", description="Speeds of that ramp, and of taking off what is within tolerance"),
    Setting(name="configure_timeout", most=3600.0, default=(3.0,), unit="s", description="How long the base may take to answer at first"),
)  # fmt: skip
