"""A file that extends a scenario: misspelt names, components left out, and emptied tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from freeflyer.foundation.errors import ScenarioError
from freeflyer.scenario import assemble, scenario
from freeflyer.scenario.inheritance import EMPTIED, merged

BOTH = 'without = ["manipulator_controller", "base_controller"]\n'


def loaded(folder: Path, text: str, base: str = "multirate_passive") -> scenario.Scenario:
    path = folder / "mine.toml"
    path.write_text(f'extends = "{base}"\n{text}\n')
    return scenario.load(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[components.base_controler.parameters]\nperiod = 0.2",
            "components.base_controler: the extended scenario has no such component, and a new component needs step_s; did you mean 'base_controller'?",
        ),
        ("[components.base_controler]", "did you mean 'base_controller'?"),
        (
            "[components.base_controller_2]\nfmu = 'base_controller'",
            "component base_controller_2 has no step_s; its communication step in seconds is expected",
        ),
        (
            "[devices.base_controler]\nchannel = 'x'",
            "no component 'base_controler' to replace; did you mean 'base_controller'?",
        ),
        ("[devices.base_controller]\nchannel = 'x'", "devices.base_controller has no kind"),
        ("without = 3", "'without' is 3; a list of component names is expected"),
    ],
)
def test_a_misspelt_component_is_rejected(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        loaded(tmp_path, text)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"scenario {tmp_path / 'mine.toml'}: ")


def test_what_names_a_component_left_out_is_left_out() -> None:
    signal = {"gone": "gone.x", "kept": "kept.x"}
    base: dict[str, Any] = {
        "components": {name: {"step_s": 1} for name in signal},
        "devices": {name: {"kind": "can_arm"} for name in signal},
        "connections": ["gone.x -> kept.y", "kept.x -> gone.y, kept.z"],
        "limits": [{"signal": text, "maximum": 1, "cause": "gone.x"} for text in signal.values()],
        "errors": {name: [text, "kept.y"] for name, text in signal.items()}
        | {"table": {"actual": "kept.x", "desired": "gone.x", "kind": "position"}},
        "observed_energy": signal,
        "roles": {"base_position": "gone.x", "preview": ["gone.x", "kept.x"]},
        "record": {"every_s": 1, "signals": ["gone.*", "kept.*", "*.x"]},
        "facility": {"seed": 2, "faults": [{"device": name, "kind": "cut"} for name in signal]},
    }
    assert merged(base, {"without": ["gone"]}) == {
        "components": {"kept": {"step_s": 1}},
        "devices": {"kept": {"kind": "can_arm"}},
        "connections": ["kept.x -> kept.z"],
        "limits": [{"signal": "kept.x", "maximum": 1, "cause": "gone.x"}],
        "errors": {"kept": ["kept.x", "kept.y"]},
        "observed_energy": {"kept": "kept.x"},
        "roles": {"preview": ["kept.x"]},
        "record": {"every_s": 1, "signals": ["kept.*", "*.x"]},
        "facility": {"seed": 2, "faults": [{"device": "kept", "kind": "cut"}]},
    }


@pytest.mark.parametrize(
    "text", [BOTH, f"{BOTH}limits = []\nerrors = {{}}\nobserved_energy = {{}}"]
)
def test_a_plant_remains_without_its_controllers(tmp_path: Path, text: str) -> None:
    found = loaded(tmp_path, f"stop_s = 0.01\n{text}")
    assert [spec.name for spec in found.components] == ["free_flyer", "reference_trajectory"]
    with assemble.assembled(found):
        pass


def test_a_reference_to_a_component_left_out_is_named(tmp_path: Path) -> None:
    found = loaded(tmp_path, 'without = ["base_controller"]')
    sentence = r"^manipulator_controller\.base_period = '=base_controller\.period': there is no component 'base_controller'.*; set another value of manipulator_controller\.base_period$"
    with pytest.raises(ScenarioError, match=sentence), assemble.loaded(found):
        pass


@pytest.mark.parametrize("key", EMPTIED)
def test_an_empty_list_or_table_removes_the_inherited_entries(key: str) -> None:
    raw, _ = scenario.tables("facility")
    raw.setdefault("roles", {"base_position": "base_robot.base_position"})
    assert raw[key]
    empty: Any = type(raw[key])()
    assert merged(raw, {key: empty}) == {**raw, key: empty}


@pytest.mark.parametrize("key", ["robot", "record", "facility", "components"])
def test_the_empty_header_of_other_tables_changes_nothing(key: str) -> None:
    base = {key: {"x": {"y": 1}}, "components": {"a": {"step_s": 1, "parameters": {"x": 1}}}}
    assert merged(base, {key: {}}) == base
    assert merged(base, {"components": {"a": {"parameters": {}}}}) == base


def test_a_component_may_be_named_like_a_form_of_a_value() -> None:
    base = {"components": {"first": {"step_s": 1}, "other": {"step_s": 1}}}
    found = merged(base, {"components": {"first": {"step_s": 2}}})
    assert found["components"] == {"first": {"step_s": 2}, "other": {"step_s": 1}}


def test_new_connections_replace_inherited_ones_in_both_lists() -> None:
    base = {"connections": ["a.x -> b.u, b.v"], "delayed": ["a.x -> b.w"]}
    found = merged(base, {"connections": ["a.y -> b.w"], "delayed": ["a.y -> b.v"]})
    assert found == {"connections": ["a.x -> b.u", "a.y -> b.w"], "delayed": ["a.y -> b.v"]}


# Relative paths


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory that is not the folder of the files."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        ("can_arm", "dbc", "mine.dbc"),
        ("cia402_arm", "eds", "folder/mine.eds"),
        ("zenoh_base", "certificates", "certs"),
        ("simulated", "fmu", "mine.fmu"),
        ("python", "object", "mine.py:make"),
        ("twin", "block", "mine.py"),
        ("twin", "robot", "mine.toml"),
    ],
)
def test_a_path_is_relative_to_its_file_or_to_the_working_directory(
    elsewhere: Path, tmp_path: Path, kind: str, name: str, value: str
) -> None:
    # A file: the option stays relative to the file, also if another folder's file extends it.
    (tmp_path / "base.toml").write_text(
        f'extends = "multirate_passive"\n[devices.free_flyer]\nkind = "{kind}"\n{name} = "{value}"\n'
    )
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner/mine.toml").write_text('extends = "../base.toml"\n')
    inherited = scenario.load(tmp_path / "inner/mine.toml").devices[0].options[name]
    assert inherited == str(tmp_path / value)
    # A change: relative to the working directory, as a text and as a mapping.
    target = f"devices.free_flyer.{name}"
    for changes in ([f"{target}={value}"], {target: value}):
        for found in (
            scenario.load(tmp_path / "base.toml", changes),
            scenario.load(tmp_path / "base.toml").changed(changes),
        ):
            assert found.devices[0].options[name] == str(elsewhere / value)


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        ("can_arm", "channel", "mine.dbc"),
        ("can_arm", "dbc", ""),
        ("can_arm", "dbc", "/tmp/mine.dbc"),
        ("simulated", "fmu", "free_flyer"),
        ("python", "object", "package.module:make"),
        ("twin", "robot", "lwr4"),
        ("of_another_package", "file", "mine.txt"),
    ],
)
def test_other_options_are_not_changed(kind: str, name: str, value: str) -> None:
    changes = [f"devices.free_flyer.{name}={value}"]
    raw: dict[str, Any] = {"components": {}, "devices": {"free_flyer": {"kind": kind}}}
    scenario.apply(raw, changes)
    assert raw["devices"]["free_flyer"][name] == value
