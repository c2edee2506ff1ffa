"""Faults of an arm of CiA 402 drives on classic CAN, in virtual time, default settings."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from families import family

from freeflyer.scenario import scenario
from freeflyer_adapters.cia402.state_machine import DriveState
from freeflyer_adapters.facility.accelerated import accelerated
from freeflyer_adapters.facility.virtual_cia402 import VirtualCia402
from freeflyer_adapters.loop import hil

BEGIN = 0.1


FAULTS: list[tuple[str, dict[str, object], str | None]] = [
    ("cut", {}, "cycles? in a row were lost"),
    ("cut", {"direction": "to_device"}, "EMCY|left the state Operation enabled|fault|lost"),
    ("cut", {"direction": "to_controller"}, "cycles? in a row were lost"),
    ("loss", {"probability": 0.01, "direction": "to_controller"}, None),
    ("bus_off", {}, "cycles? in a row were lost"),
    ("hung", {}, "cycles? in a row were lost"),
    ("dead", {}, "cycles? in a row were lost"),
    ("device_fault", {}, "left the state Operation enabled by itself: it is in the state Fault"),
]


@pytest.mark.parametrize(
    ("kind", "how", "reason"), family(FAULTS, [FAULTS[0], FAULTS[3], FAULTS[7]])
)
def test_a_fault_of_the_drives_stops_the_loop_with_brakes(
    kind: str, how: dict[str, object], reason: str | None
) -> None:
    chosen = scenario.load("facility_cia402", ["stop_s=0.4"])
    fault = {"kind": kind, "device": "arm_drive", "begin_s": BEGIN, **how}
    chosen = replace(chosen, facility={**chosen.facility, "faults": [fault]})
    with accelerated(chosen) as both:
        result, report = hil.run(chosen, real_time=False, show=lambda text: None)
        arm = both.facility.devices[0]
        assert isinstance(arm, VirtualCia402)
        logic = arm.logic
        both.time.sleep(0.7)
        if reason is None:
            assert result.as_expected, report.stop
            assert report.devices["arm_drive"]["cycles_lost"] > 0
        else:
            assert re.search(reason, report.stop), report.stop
            assert result.outcome.simulated < BEGIN + 0.15
        if kind != "hung":
            assert all(drive.state is not DriveState.operation_enabled for drive in logic.drives)
            assert not logic.torque.any()
