"""The scenario's table `[facility]`: how the virtual devices' own controllers behave."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.scenario.scenario import Scenario
from freeflyer_adapters.device.device import DeviceError
from freeflyer_adapters.facility import faults
from freeflyer_adapters.facility.faults import Fault, RandomFaults

WATCHDOG_CYCLES, WATCHDOG = (
    ("watchdog_cycles", "arm_watchdog_cycles"),
    ("watchdog", "base_watchdog_s"),
)
"""The controllers' parameter, and the key of [facility]."""


@dataclass(frozen=True, kw_only=True)
class FacilitySettings:
    """Defaults are this project's; no real facility's are known."""

    arm_watchdog_cycles: int = 4
    """Age of the last command at which the arm goes to safe stop, so that it is safe within five cycles."""
    base_watchdog_s: float = 0.02
    """Without a set point for so long the base holds its place."""
    forget_after_s: float = 1.0
    """Silence after which a controller is forgotten; then the robots return to their start poses."""
    base_jump_m: float = 0.01
    base_jump_rad: float = 0.02
    """How far from the robot a first set point may be."""
    measure_every: int = 4
    """Base measurements are published every so many arm cycles."""
    describe_every: int = 100
    """The arm describes itself every so many cycles while it is not active."""
    ramp_down_time_s: float = 0.25
    ramp_down_damping: float = 5.0
    """[N m s/rad]"""
    seed: int = 1
    """Of everything random in the faults."""
    faults: tuple[Fault, ...] = ()
    random_faults: RandomFaults | None = None

    def faults_of(self, device: str) -> tuple[Fault, ...]:
        return tuple(fault for fault in self.faults if fault.device == device)


def with_watchdogs(scenario: Scenario) -> Scenario:
    """The controllers' side of a scenario whose [facility] names the devices' watchdogs: the fact is stated once, for both ends.

    A device's own parameter `watchdog_cycles` (arm) or `watchdog` (base) comes before it. DeviceError for a wrong table.
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
    """DeviceError for a key or value that is none."""
    known = {f.name: f for f in fields(FacilitySettings)}
    readers: Mapping[str, Callable[[Any], Any]] = {
        "faults": faults.read,
        "random_faults": faults.read_random,
    }
    for key, value in raw.items():
        if key not in known:
            raise DeviceError(f"[facility] {key} is not known{did_you_mean(key, known)}")
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
