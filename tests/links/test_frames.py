"""Frames of the arm: the shipped DBC, a user's DBC, and errors in a user's DBC."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer_adapters.arm.can_arm import CanArm
from freeflyer_adapters.arm.frames import (
    CONSEQUENCES,
    NEEDED,
    SHIPPED_DBC,
    ArmFrames,
    FrameMapping,
    Mode,
)
from freeflyer_adapters.arm.options import ArmOptions, options_from
from freeflyer_adapters.can.bus_load import bus_load, frame_time
from freeflyer_adapters.foundation.errors import DeviceError


@cache
def shipped() -> ArmFrames:
    return ArmFrames(FrameMapping(), 6)


ROOM = {"joint_position": 8.0, "joint_velocity": 6.5, "joint_torque": 327.0}

OWN = """VERSION ""
NS_ :
BS_:
BU_: PC Drive
BO_ 512 TORQUES: 16 PC
 SG_ Tau_A : 7|16@0- (0.01,0) [0|0] "Nm" Drive
 SG_ Tau_B : 23|16@0- (0.01,0) [0|0] "Nm" Drive
BO_ 513 STATUS: 16 Drive
 SG_ N : 7|8@0+ (1,0) [0|0] "" PC
 SG_ Q_A : 15|16@0- (0.01,0) [0|0] "deg" PC
 SG_ Q_B : 31|16@0- (0.01,0) [0|0] "deg" PC
 SG_ W_A : 47|16@0- (0.1,0) [0|0] "deg/s" PC
 SG_ W_B : 63|16@0- (0.1,0) [0|0] "deg/s" PC
 SG_ T_A : 79|16@0- (0.01,0) [0|0] "Nm" PC
 SG_ T_B : 95|16@0- (0.01,0) [0|0] "Nm" PC
"""
SIGNALS = {
    "cycle": "N",
    "joint_torque_command": ["Tau_A", "Tau_B"],
    "joint_position": ["Q_A", "Q_B"],
    "joint_velocity": ["W_A", "W_B"],
    "joint_torque": ["T_A", "T_B"],
}
MESSAGES = {"command": "TORQUES", "state": "STATUS"}


def own(folder: Path, text: str = OWN) -> Path:
    path = folder / "own.dbc"
    path.write_text(text)
    return path


@given(st.data())
def test_packing_and_unpacking_returns_values_within_half_the_resolution(
    draw: st.DataObject,
) -> None:
    numbers = {
        name: draw.draw(st.lists(st.floats(-room, room), min_size=6, max_size=6), label=name)
        for name, room in ROOM.items()
    }
    numbers |= {"cycle": [float(draw.draw(st.integers(0, 2**24 - 1)))], "life_cycle": [2.0]}
    found = shipped().state.unpack(shipped().state.pack(numbers))
    for name, values in numbers.items():
        half = 0.5 * shipped().state.fields[name][0].resolution
        assert found[name] == pytest.approx(values, abs=half * 1.0001)


def test_values_beyond_the_range_of_a_signal_are_clamped() -> None:
    found = shipped().state.unpack(
        shipped().state.pack({"joint_torque": [1e9, -1e9, 0.0, 0.0, 0.0, 0.0]})
    )
    assert found["joint_torque"][:2] == pytest.approx([327.67, -327.68])


def test_the_shipped_frames_hold_seven_joints_and_fit_the_bus_in_a_cycle() -> None:
    seven = ArmFrames(FrameMapping(), 7)
    assert (seven.command.size, seven.state.size) == (24, 64)
    assert bus_load([(f.size, f.is_fd) for f in (seven.command, seven.state)], 1e-3) < 0.35
    # At 1 Mbit/s, 14 classic frames (one command and one state frame per joint) exceed the cycle.
    assert 14 * frame_time(8, False) / 1e-3 > 1.0


def test_the_longest_frame_of_eight_bytes_agrees_with_the_literature() -> None:
    """At most 135 bits for 8 data bytes and an 11-bit identifier (Davis et al. 2007)."""
    assert frame_time(8, False, nominal=1e6) == pytest.approx(135e-6)


def test_every_message_has_its_own_data_id_and_cycle_time() -> None:
    assert shipped().description is not None
    frames = (shipped().command, shipped().state, shipped().description)
    assert len({frame.data_id for frame in frames}) == 3
    assert None not in {frame.data_id for frame in frames}
    assert [frame.cycle_ms for frame in frames] == [1.0, 1.0, 100.0]


def test_a_users_own_dbc_in_other_units_and_byte_order(tmp_path: Path) -> None:
    frames = ArmFrames(FrameMapping(dbc=own(tmp_path), messages=MESSAGES, signals=SIGNALS), 2)
    assert "mode" not in frames.command
    assert frames.state.data_id is None
    found = frames.state.unpack(
        frames.state.pack({"joint_position": [0.5, -1.0], "joint_velocity": [1.0, 0.0]})
    )
    assert found["joint_position"] == pytest.approx([0.5, -1.0], abs=np.radians(0.005))
    assert found["joint_velocity"] == pytest.approx([1.0, 0.0], abs=np.radians(0.05))
    data = frames.command.pack({"joint_torque_command": [1.0, -1.0]})
    assert data[:4].hex() == "0064ff9c"  # 100 and -100 hundredths, most significant byte first


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"signals": {**SIGNALS, "joint_torque": ["T_A", "T_C"]}}, "lacks the signal 'T_C'"),
        ({"signals": {**SIGNALS, "joint_torque": ["T_A"]}}, "names 1 signals; 2 are expected"),
        ({"signals": {**SIGNALS, "joint_torques": "T{}"}}, "did you mean 'joint_torque'"),
        ({"signals": {}}, "lacks the signal 'TorqueCommand1'"),
        ({"messages": {**MESSAGES, "state": "STATE"}}, "no message 'STATE'"),
        ({"dbc": Path("none.dbc")}, "cannot be read"),
    ],
)
def test_a_mapping_that_does_not_fit_is_rejected(
    tmp_path: Path, change: dict[str, object], sentence: str
) -> None:
    arguments = {"dbc": own(tmp_path), "messages": MESSAGES, "signals": SIGNALS, **change}
    with pytest.raises(DeviceError, match=sentence) as caught:
        ArmFrames(FrameMapping(**arguments), 2)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (OWN.replace("513 STATUS: 16", "513 STATUS: 8"), "cannot be used"),
        (OWN.replace("513 STATUS: 16", "513 STATUS: 17"), "has 17 bytes"),
        (OWN.replace('"deg" PC', '"N" PC'), "is in 'N'; rad is expected"),
        ("BO_ nonsense", "cannot be used"),
        (OWN + "SIG_VALTYPE_ 513 Q_A : 1;\n", "floating-point|cannot be used"),
    ],
)
def test_a_dbc_that_cannot_be_used_is_rejected(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(DeviceError, match=sentence) as caught:
        ArmFrames(FrameMapping(dbc=own(tmp_path, text), messages=MESSAGES, signals=SIGNALS), 2)
    assert "\n" not in str(caught.value)


def test_a_scale_that_cannot_hold_the_torque_range_is_rejected_with_the_numbers(
    tmp_path: Path,
) -> None:
    frames = ArmFrames(FrameMapping(dbc=own(tmp_path), messages=MESSAGES, signals=SIGNALS), 2)
    frames.check_ranges({"joint_torque_command": [(-176.0, 176.0)] * 2})
    with pytest.raises(
        DeviceError, match=r"Tau_A holds -327.68 to 327.67 N.m, but the robot needs -400 to 400 N.m"
    ):
        frames.check_ranges({"joint_torque_command": [(-400.0, 400.0)] * 2})


def test_the_shipped_dbc_exists() -> None:
    assert SHIPPED_DBC.is_file()


# Optional signals of a DBC

WHOLE = OWN.replace(
    "BO_ 513",
    ' SG_ Order : 39|8@0+ (1,0) [0|0] "" Drive\n'
    ' SG_ Sender : 47|8@0+ (1,0) [0|0] "" Drive\n'
    ' SG_ Answered : 55|8@0+ (1,0) [0|0] "" Drive\n'
    "BO_ 513",
) + (
    ' SG_ Accepted : 111|8@0+ (1,0) [0|0] "" PC\n'
    ' SG_ Life : 119|4@0+ (1,0) [0|0] "" PC\n'
    ' SG_ Brakes : 115|1@0+ (1,0) [0|0] "" PC\n'
    ' SG_ Echo : 127|8@0+ (1,0) [0|0] "" PC\n'
)
EVERYTHING = {
    **SIGNALS,
    "mode": "Order",
    "controller": "Sender",
    "answered_cycle": "Answered",
    "obeyed_controller": "Accepted",
    "life_cycle": "Life",
    "brakes": "Brakes",
    "echoed_cycle": "Echo",
}
OPTIONAL = [name for name in CONSEQUENCES if name not in NEEDED]


def mapped(folder: Path, *without: str) -> FrameMapping:
    signals = {role: name for role, name in EVERYTHING.items() if role not in without}
    values = {} if "mode_values.activate" in without else {"activate": 4}
    return FrameMapping(
        dbc=own(folder, WHOLE), messages=MESSAGES, signals=signals, mode_values=values
    )


def test_a_complete_dbc_is_accepted_without_limits(tmp_path: Path) -> None:
    frames = ArmFrames(mapped(tmp_path), 2)
    frames.check_activation("arm", implicit=False)
    assert frames.missing == []
    assert frames.cannot_refuse(implicit=False) == []
    CanArm("arm", ArmOptions(joints=2, frames=mapped(tmp_path)))


@pytest.mark.parametrize("name", NEEDED)
def test_a_dbc_that_cannot_reject_an_activation_needs_activation_implicit(
    tmp_path: Path, name: str
) -> None:
    mapping = mapped(tmp_path, name)
    frames = ArmFrames(mapping, 2)
    sentence = rf'arm: DBC .* has no {name}, so the arm itself cannot reject .* write activation = "implicit"'
    with pytest.raises(DeviceError, match=sentence):
        frames.check_activation("arm", implicit=False)
    with pytest.raises(DeviceError, match=sentence):
        CanArm("arm", ArmOptions(joints=2, frames=mapping))
    frames.check_activation("arm", implicit=True)
    arm = CanArm("arm", ArmOptions(joints=2, frames=mapping, implicit=True))
    assert arm.cannot_refuse == [f"without {name}, {CONSEQUENCES[name]}"]


@pytest.mark.parametrize("name", OPTIONAL)
def test_a_dbc_without_an_optional_signal_is_accepted_and_reported(
    tmp_path: Path, name: str
) -> None:
    arm = CanArm("arm", ArmOptions(joints=2, frames=mapped(tmp_path, name)))
    assert arm.cannot_refuse == [f"without {name}, {CONSEQUENCES[name]}"]


def test_all_missing_signals_are_named_in_one_error(tmp_path: Path) -> None:
    frames = ArmFrames(mapped(tmp_path, *CONSEQUENCES), 2)
    with pytest.raises(DeviceError) as caught:
        frames.check_activation("arm", implicit=False)
    assert all(name in str(caught.value) for name in NEEDED)
    assert not any(name in str(caught.value) for name in OPTIONAL)
    assert len(frames.cannot_refuse(implicit=True)) == len(CONSEQUENCES)


def test_a_number_for_activate_needs_a_mode_signal(tmp_path: Path) -> None:
    frames = ArmFrames(mapped(tmp_path, "mode"), 2)
    assert "mode_values.activate" in frames.missing


def test_implicit_activation_of_a_complete_dbc_reports_the_limit() -> None:
    arm = CanArm("arm", ArmOptions(implicit=True))
    assert arm.cannot_refuse == [
        f'with activation = "implicit", {CONSEQUENCES["mode_values.activate"]}'
    ]
    assert CanArm("arm", ArmOptions()).cannot_refuse == []


@pytest.mark.parametrize(
    ("options", "implicit"),
    [({}, False), ({"activation": "explicit"}, False), ({"activation": "implicit"}, True)],
)
def test_the_activation_option_selects_the_kind_of_activation(
    tmp_path: Path, options: dict[str, Any], implicit: bool
) -> None:
    assert options_from("arm", options, tmp_path).implicit is implicit


def test_an_unknown_kind_of_activation_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(
        DeviceError, match="activation is 'automatic'; 'explicit' or 'implicit' is expected"
    ):
        options_from("arm", {"activation": "automatic"}, tmp_path)


def test_a_copy_of_the_shipped_dbc_counts_as_the_shipped_profile(tmp_path: Path) -> None:
    mapping = FrameMapping(dbc=own(tmp_path, SHIPPED_DBC.read_text()))
    assert mapping.has_shipped_names
    frames = ArmFrames(mapping, 6)
    assert frames.missing == []
    assert frames.mode_number(Mode.activate) == Mode.activate


OPTIONAL_SIGNALS = [
    "AnsweredCycle",
    "Mode",
    "EchoedCycle",
    "LifeCycle",
    "BrakesEngaged",
    "CommandAge",
]


@pytest.mark.parametrize("name", OPTIONAL_SIGNALS)
def test_a_copy_with_one_different_name_is_not_the_shipped_profile(
    tmp_path: Path, name: str
) -> None:
    text = SHIPPED_DBC.read_text().replace(f" {name} ", f" {name}X ")
    mapping = FrameMapping(dbc=own(tmp_path, text))
    assert not mapping.has_shipped_names
    with pytest.raises(DeviceError, match=r"has no mode_values\.activate, controller"):
        ArmFrames(mapping, 6).check_activation("arm", implicit=False)


def test_a_copy_of_the_shipped_dbc_with_a_mapping_uses_mapped_signals_only(tmp_path: Path) -> None:
    mapping = FrameMapping(dbc=own(tmp_path, SHIPPED_DBC.read_text()), signals={"mode": "Mode"})
    assert not mapping.has_shipped_names
    assert "controller" in ArmFrames(mapping, 6).missing


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        (OWN, {"command": "STATUS", "state": "STATUS"}),
        (OWN.replace("BO_ 513", "BO_ 512"), MESSAGES),
    ],
)
def test_command_and_state_frame_with_one_identifier_are_rejected(
    tmp_path: Path, text: str, messages: dict[str, str]
) -> None:
    signals = (
        SIGNALS if messages == MESSAGES else {**SIGNALS, "joint_torque_command": ["T_A", "T_B"]}
    )
    with pytest.raises(
        DeviceError,
        match=r"have the same identifier 0x20[01], but two nodes must not send frames with the same identifier",
    ) as caught:
        ArmFrames(FrameMapping(dbc=own(tmp_path, text), messages=messages, signals=signals), 2)
    assert "\n" not in str(caught.value)


def test_a_standard_and_an_extended_identifier_with_one_number_differ(tmp_path: Path) -> None:
    text = OWN.replace("BO_ 513", f"BO_ {512 + (1 << 31)}")
    frames = ArmFrames(FrameMapping(dbc=own(tmp_path, text), messages=MESSAGES, signals=SIGNALS), 2)
    assert frames.command.identifier == frames.state.identifier == 512


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"activate": 3}, "mode_values: .* has the number 3, but another name has the same"),
        ({"activate": 256}, "activate has the number 256, but its signal Order holds 255 at most"),
        ({"activated": 4}, "did you mean 'activate'"),
    ],
)
def test_an_invalid_number_for_activate_is_rejected(
    tmp_path: Path, values: dict[str, int], sentence: str
) -> None:
    mapping = FrameMapping(
        dbc=own(tmp_path, WHOLE), messages=MESSAGES, signals=EVERYTHING, mode_values=values
    )
    with pytest.raises(DeviceError, match=sentence):
        ArmFrames(mapping, 2)
