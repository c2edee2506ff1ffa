"""Scenario table `[facility]`: settings of the virtual devices."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from freeflyer.foundation.suggestions import unknown_keys
from freeflyer.scenario.scenario import Scenario
from freeflyer_adapters.facility import faults
from freeflyer_adapters.facility.faults import Fault, RandomFaults
from freeflyer_adapters.foundation.errors import DeviceError

WATCHDOG_CYCLES, WATCHDOG = (
    ("watchdog_cycles", "arm_watchdog_cycles"),
    ("watchdog", "base_watchdog_s"),
)
"""Each pair contains a parameter of a device, and the key of [facility] with the same meaning."""


@dataclass(frozen=True, kw_only=True)
class FacilitySettings:
    """Settings of a virtual facility. The default values do not describe a real facility."""

    arm_watchdog_cycles: int = 4
    """Age of the last command [cycles] at which the arm goes to the state safe_stop.

    With the default value, the arm goes to this state within five cycles after the last command."""
    base_watchdog_s: float = 0.02
    """Time without a set point [s] after which the base holds its position."""
    forget_after_s: float = 1.0
    """Time without a message [s] after which the session ends. The robots then return to their
    start poses."""
    base_jump_m: float = 0.01
    base_jump_rad: float = 0.02
    """Limits of the base for the step to a new set point: distance [m] and angle [rad].

    The step to the first set point starts at the pose of the robot. Every later step starts at the
    previous set point."""
    measure_every: int = 4
    """Arm cycles between two measurements of the base."""
    describe_every: int = 100
    """Cycles between two description frames. An active arm sends no description frames."""
    ramp_down_time_s: float = 0.25
    ramp_down_damping: float = 5.0
    """Damping of the joint speeds during the ramp-down [N m s/rad]."""
    seed: int = 1
    """Seed of the random effects of the faults. The choice of random faults has its own seed."""
    faults: tuple[Fault, ...] = ()
    random_faults: RandomFaults | None = None

    def faults_of(self, device: str) -> tuple[Fault, ...]:
        """Return the faults of a device."""
        return tuple(fault for fault in self.faults if fault.device == device)


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
    known = {f.name: f for f in fields(FacilitySettings)}
    readers: Mapping[str, Callable[[Any], Any]] = {
        "faults": faults.read,
        "random_faults": faults.read_random,
    }
    for key, hint in unknown_keys(raw, known):
        raise DeviceError(f"[facility] {key} is not known{hint}")
    for key, value in raw.items():
        if key in readers:
            continue
        whole = isinstance(known[key].default, int)
        fits = isinstance(value, int) if whole else isinstance(value, int | float)
        if isinstance(value, bool) or not fits or not 0 < value < 1e6:
            raise DeviceError(
                f"[facility] {key} is {value!r}; a {'whole ' if whole else ''}number greater than zero is expected"
            )
    values: dict[str, Any] = {
        key: readers[key](value) if key in readers else value for key, value in raw.items()
    }
    return FacilitySettings(**values)
