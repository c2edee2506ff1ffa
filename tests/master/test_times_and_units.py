"""Times and other values with units: accepted where a number in this unit is expected."""

from __future__ import annotations

from pathlib import Path

import pytest

from freeflyer.foundation.errors import CosimError, ScenarioError
from freeflyer.foundation.toml_file import as_written
from freeflyer.foundation.units import in_unit
from freeflyer.scenario import scenario
from freeflyer_adapters.cia402.options import options_from
from freeflyer_adapters.facility import settings

LIMIT = '[[limits]]\nsignal = "free_flyer.base_velocity"\nmaximum = 9\nfor_s = '


def loaded(folder: Path, text: str) -> scenario.Scenario:
    path = folder / "mine.toml"
    path.write_text(f'extends = "multirate_passive"\n{text}\n')
    return scenario.load(path)


@pytest.mark.parametrize("time", ["0.02", '"20 ms"', '{ value = 20, unit = "ms" }', '"2e4 us"'])
def test_every_time_of_a_scenario_file_may_have_a_unit(tmp_path: Path, time: str) -> None:
    found = loaded(
        tmp_path,
        f"stop_s = {time}\n[record]\nevery_s = {time}\n[components.free_flyer]\nstep_s = {time}\n{LIMIT}{time}",
    )
    times = [found.stop, found.record_every, found.components[0].step, found.limits[-1].lasting]
    assert times == [20_000_000] * 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("stop_s=20ms", "stop_s is '20ms'; a number of seconds is expected, or a time with a unit"),
        ("stop_s=20 kg", "stop_s is 20 kg; unit 'kg' cannot be converted to 's'"),
        ("stop_s=1e12", "stop_s is 1000000000000.0 s; at most 9000000000 s is expected"),
        ("stop_s={value=[20],unit='ms'}", "stop_s is [20] ms; a number of seconds"),
        ("stop_s={value=20}", "stop_s is { value = 20 }; a number of seconds"),
        ("stop_s=2026-01-01", "stop_s is 2026-01-01; a number of seconds"),
        ("record.every_s=1 kg", "[record] every_s is 1 kg; unit 'kg' cannot"),
        ("free_flyer.step_s=1 m", "component free_flyer: step_s is 1 m; unit 'm' cannot"),
        ("exchange=5 ms", "exchange is 5 ms; 'sequential' or 'parallel' is expected"),
        ("stop_s=1\nx=2", r"stop_s is '1\nx=2'; a number of seconds"),
    ],
)
def test_a_wrong_time_is_reported_as_it_was_written(change: str, message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        scenario.load("multirate_passive", [change])
    assert message in str(caught.value)


def test_settings_of_the_facility_may_have_units() -> None:
    fault = {"kind": "delay", "device": "a", "begin_s": "1 min", "delay_s": "2 ms"}
    found = settings.read(
        {
            "base_watchdog_s": "30 ms",
            "base_jump_rad": "180 deg",
            "faults": [fault],
            "random_faults": {"longest_s": {"value": 0.5, "unit": "s"}},
        }
    )
    assert (found.base_watchdog_s, found.base_jump_rad) == (0.03, pytest.approx(3.14159265))
    assert (found.faults[0].begin_s, found.faults[0].delay_s) == (60.0, 0.002)
    assert found.random_faults is not None
    assert found.random_faults.longest_s == 0.5
    with pytest.raises(
        CosimError, match=r"^\[facility\] base_watchdog_s is '3 kg'; unit 'kg' cannot"
    ):
        settings.read({"base_watchdog_s": "3 kg"})


def test_options_of_drives_may_have_units() -> None:
    table = {"rated_torque": "500 mN.m", "heartbeat_s": "200 ms", "bitrate": "500 kbit/s"}
    found = options_from("arm", table, Path())
    assert [motor.rated_torque for motor in found.motors] == [0.5] * 6
    assert (found.heartbeat, found.bitrate) == (0.2, 500e3)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ({"value": 20.0, "unit": "ms"}, "20 ms"),
        ({"a": True, "b": [1, "x"]}, "{ a = true, b = [1, 'x'] }"),
        ({}, "{}"),
        (None, "missing"),
        ("x" * 999, "'" + "x" * 199),
    ],
)
def test_a_message_shows_a_value_as_it_is_written_in_toml(value: object, text: str) -> None:
    assert as_written(value) == text


@pytest.mark.parametrize("value", [3, "fast", "3", True, None, [1], {"value": True, "unit": "s"}])
def test_a_value_without_a_unit_is_not_changed(value: object) -> None:
    assert in_unit(value, "s") is value
