"""Scenario table `[facility]`: settings of the virtual devices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from freeflyer.foundation import keys
from freeflyer.foundation.keys import ANY, Key, expecting, keys_of, setting, table_schema
from freeflyer.scenario.scenario import Scenario
from freeflyer_adapters.facility import faults
from freeflyer_adapters.facility.faults import FAULTS, RANDOM, Fault, RandomFaults
from freeflyer_adapters.foundation.errors import DeviceError

WATCHDOG_CYCLES, WATCHDOG = (
    ("watchdog_cycles", "arm_watchdog_cycles"),
    ("watchdog", "base_watchdog_s"),
)
"""Each pair contains a parameter of a device, and the key of [facility] with the same meaning."""


def _setting(default: float, meaning: str, unit: str = "") -> Any:
    kind, expected = ("integer", "whole number") if isinstance(default, int) else ("number",) * 2
    schema = {"type": kind, "exclusiveMinimum": 0, "exclusiveMaximum": 1e6}
    of_type = expecting(schema, f"a {expected} greater than zero is expected", unit)
    return setting(Key(of_type, meaning, default=default))


@dataclass(frozen=True, kw_only=True)
class FacilitySettings:
    """Settings of a virtual facility, in SI units. The defaults do not describe a real facility."""

    # fmt: off
    arm_watchdog_cycles: int = _setting(4, "Age of the last command [cycles] at which the arm goes to the state safe_stop. With the default value, the arm goes to this state within five cycles after the last command")
    base_watchdog_s: float = _setting(0.02, "Time without a set point [s] after which the base holds its position", "s")
    forget_after_s: float = _setting(1.0, "Time without a message [s] after which the session ends. The robots then return to their start poses", "s")
    base_jump_m: float = _setting(0.01, "Largest distance [m] from the previous set point of the base to a new set point. For the first set point, the distance starts at the pose of the robot", "m")
    base_jump_rad: float = _setting(0.02, "Largest angle [rad] from the previous set point of the base to a new set point", "rad")
    measure_every: int = _setting(4, "Arm cycles between two measurements of the base")
    describe_every: int = _setting(100, "Cycles between two description frames. An active arm sends no description frames")
    ramp_down_time_s: float = _setting(0.25, "Damped ramp-down: time [s] until the torque is zero", "s")
    ramp_down_damping: float = _setting(5.0, "Damping of the joint speeds during the ramp-down [N m s/rad]", "N.m.s/rad")
    seed: int = _setting(1, "Seed of the random effects of the faults. The choice of random faults has its own seed")
    faults: tuple[Fault, ...] = setting(Key(ANY, "`[[facility.faults]]`: scheduled faults", inner=FAULTS), ())
    random_faults: RandomFaults | None = setting(Key(ANY, "random faults", inner=table_schema(RANDOM)))
    # fmt: on

    def faults_of(self, device: str) -> tuple[Fault, ...]:
        """Return the faults of a device."""
        return tuple(fault for fault in self.faults if fault.device == device)


KEYS = keys_of(FacilitySettings)
"""Keys of [facility]."""


def with_watchdogs(scenario: Scenario) -> Scenario:
    """Return a copy of the scenario that has the watchdogs of [facility] as device parameters.

    With these parameters, the controllers use the same watchdogs as the facility. If a device
    already has the parameter `watchdog_cycles` (arm) or `watchdog` (base), the value of this
    parameter is kept.
    Raises DeviceError if the table [facility] is invalid.
    """
    settings = read(scenario.facility)
    known = {"can_arm": WATCHDOG_CYCLES, "cia402_arm": WATCHDOG_CYCLES, "zenoh_base": WATCHDOG}
    devices = []
    for spec in scenario.devices:
        parameter, key = known.get(spec.kind, ("", ""))
        if key in scenario.facility and parameter not in spec.parameters:
            spec = replace(
                spec, parameters={**spec.parameters, parameter: float(getattr(settings, key))}
            )
        devices.append(spec)
    return replace(scenario, devices=tuple(devices))


def read(raw: Mapping[str, Any]) -> FacilitySettings:
    """Read the table [facility]. Raises DeviceError for an invalid key or value."""
    given = keys.read(raw, KEYS, DeviceError, "[facility] ", unknown="{name} is not known")
    readers = {"faults": faults.read, "random_faults": faults.read_random}
    return FacilitySettings(
        **{**given, "faults": (), **{key: readers[key](raw[key]) for key in readers if key in raw}}
    )
