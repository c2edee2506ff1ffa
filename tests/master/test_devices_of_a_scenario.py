"""Tests of the table [devices]: merged and replaced keys, overrides, and invalid tables."""

from __future__ import annotations

from pathlib import Path

import pytest

from freeflyer.foundation.clock import SECOND
from freeflyer.foundation.errors import ScenarioError
from freeflyer.scenario import scenario


def loaded(folder: Path, text: str, *overrides: str) -> scenario.Scenario:
    path = folder / "changed.toml"
    path.write_text(f'extends = "facility"\n{text}')
    return scenario.load(str(path), overrides)


def test_devices_do_not_change_the_components() -> None:
    chosen = scenario.load("facility")
    assert {spec.name for spec in chosen.devices} == {"arm_drive", "base_robot"}
    assert {spec.kind for spec in chosen.components} == {"fmu"}


def test_keys_of_a_device_are_merged_unless_its_kind_changes(tmp_path: Path) -> None:
    (arm,) = (
        s
        for s in loaded(tmp_path, '[devices.arm_drive]\nchannel = "x"').devices
        if s.name == "arm_drive"
    )
    assert (arm.kind, arm.options["channel"], arm.options["interface"]) == ("can_arm", "x", "local")
    (arm,) = (
        s
        for s in loaded(tmp_path, '[devices.arm_drive]\nkind = "simulated"').devices
        if s.name == "arm_drive"
    )
    assert (arm.kind, dict(arm.options), dict(arm.parameters)) == ("simulated", {}, {})


def test_the_default_step_of_a_device_is_the_step_of_its_component(tmp_path: Path) -> None:
    (arm,) = (
        s
        for s in loaded(tmp_path, '[devices.arm_drive]\nkind = "other"').devices
        if s.name == "arm_drive"
    )
    assert arm.step == SECOND // 1000


def test_overrides_change_devices_and_facility(tmp_path: Path) -> None:
    chosen = loaded(
        tmp_path,
        "",
        'devices.arm_drive.signals.cycle="N"',
        "facility.arm_watchdog_cycles=3",
        "devices.base_robot.domain=7",
    )
    devices = {spec.name: spec.options for spec in chosen.devices}
    assert devices["arm_drive"]["signals"] == {"cycle": "N"}
    assert devices["base_robot"]["domain"] == 7
    assert chosen.facility == {"arm_watchdog_cycles": 3}


@pytest.mark.parametrize(
    ("text", "overrides", "sentence"),
    [
        ('[devices.arm_drve]\nkind = "can_arm"', (), "did you mean 'arm_drive'"),
        ("[devices]\narm_drive = 3", (), "a table with a 'kind' is expected"),
        ("devices = 3", (), "a table is expected"),
        ("", ("devices=3",), "devices.NAME.KEY=VALUE"),
        ("", ("devices.arm_drive=3",), "devices.NAME.KEY=VALUE is expected"),
        ("", ("devices.arm_drive.=3",), "is expected"),
        ("", ("devices.arm_drive.channel.x=3",), "'channel' is not a table"),
        ("", ("facility=3",), "facility.KEY=VALUE is expected"),
        ('[[limits]]\nsignal = "satellite.base_velocity"\nmaximum = 1\nfor_s = -1', (), "for_s"),
        (
            '[[limits]]\nsignal = "satellite.base_velocity"\nmaximum = 1\nfor_s = "long"',
            (),
            "a number of seconds",
        ),
    ],
)
def test_invalid_tables_are_rejected(
    tmp_path: Path, text: str, overrides: tuple[str, ...], sentence: str
) -> None:
    with pytest.raises(ScenarioError, match=sentence):
        loaded(tmp_path, text, *overrides)
