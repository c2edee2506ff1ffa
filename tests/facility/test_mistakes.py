"""User errors with hardware: one sentence, exit code 2, and no motion."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from commands import run_command
from families import family
from processes import PATIENT_FACILITY, PATIENT_LOOP, Process, Rig, events, rig

OWN_DBC = """VERSION ""
NS_ :
BS_:
BU_: PC Drive
BO_ 257 CMD: 16 PC
{command}
BO_ 385 STATE: 48 Drive
 SG_ N : 0|8@1+ (1,0) [0|0] "" PC
{state}
"""


def own_dbc(
    folder: Path,
    torque_scale: float = 0.01,
    state_size: int = 48,
    left_out: str = "",
    activation: str = "implicit",
) -> str:
    """Write the DBC of a small arm of six joints, and a scenario that uses it."""
    command = [
        f' SG_ C{i + 1} : {16 * i}|16@1- ({torque_scale},0) [0|0] "Nm" Drive' for i in range(6)
    ]
    state, first = [], 8
    for name, unit, scale in (("Q", "rad", 1e-3), ("W", "rad/s", 1e-3), ("T", "Nm", 0.01)):
        for i in range(6):
            state.append(f' SG_ {name}{i + 1} : {first}|16@1- ({scale},0) [0|0] "{unit}" PC')
            first += 16
    text = OWN_DBC.format(
        command="\n".join(command[:6]),
        state="\n".join(line for line in state if f" {left_out} :" not in line),
    )
    (folder / "own.dbc").write_text(text.replace("STATE: 48", f"STATE: {state_size}"))
    (folder / "own.toml").write_text(
        f'extends = "facility"\n[devices.arm_drive]\nactivation = "{activation}"'
        """
dbc = "own.dbc"
messages = { command = "CMD", state = "STATE" }
signals = { cycle = "N", joint_torque_command = "C{}", joint_position = "Q{}", joint_velocity = "W{}", joint_torque = "T{}" }
"""
    )
    return str(folder / "own.toml")


# Errors that are found without a device


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ('devices.arm_drive.interface="socketcam"', "did you mean 'socketcan'"),
        ('devices.arm_drive.interface="socketcan"', r"channel 'freeflyer', cannot be opened"),
        ("devices.arm_drive.interface=3", "interface is 3; a text is expected"),
        ('devices.arm_drive.channel="a/b"', "up to 32 letters"),
        ('devices.arm_drive.chanel="a"', "did you mean 'channel'"),
        ('devices.arm_drive.dbc="none.dbc"', "cannot be read"),
        ("devices.arm_drive.joints=7", "elements|joint"),
        ('devices.arm_drive.kind="can_arn"', "did you mean 'can_arm'"),
        ("devices.arm_drive.parameters.start_tolerence=1", "did you mean 'start_tolerance'"),
        ('devices.arm_drive.parameters.torque_rate_limit="fast"', "torque_rate_limit is 'fast'"),
        ("devices.hand.channel=1", "NAME one of: arm_drive, base_robot"),
        ('devices.base_robot.setpoint_topic="base robot/**"', "not a valid key expression"),
        ('devices.base_robot.measured_topic=""', "not a valid key expression"),
        ("devices.base_robot.listen=[]", "would listen on every interface"),
        ('devices.base_robot.listen=["nonsense"]', "list of endpoints"),
        ('devices.base_robot.connect="tcp/127.0.0.1:7447"', "a list is expected"),
        ("devices.base_robot.domain=1000", "a ROS domain from 0 to 232"),
        ("devices.base_robot.connect=[]", "connect is empty"),
        ('devices.base_robot.node="a*"', "a ROS node name"),
        (f'devices.base_robot.frame="{"x" * 300}"', "a frame name of 1 to 200 bytes"),
        ("devices.arm_drive.bus={bogus=1}", "no setting 'bogus'"),
        ("devices.arm_drive.bus=3", "a table is expected"),
        ("devices.arm_drive.e2e_offset=100", "does not fit into the frame"),
        ("devices.arm_drive.e2e_offset=-1", "does not fit into the frame"),
        ("devices.arm_drive.e2e_offset=3", "lies in the E2E header"),
        (
            'devices.arm_drive.data_ids={command="x"}',
            "data_ids.command is 'x'; a whole number from 0 to 65535",
        ),
        ("devices.arm_drive.data_ids={state=99999999}", "a whole number from 0 to 65535"),
        ("devices.arm_drive.messages={command=3}", "the name of a message is expected"),
        ("devices.arm_drive.signals={joint_position=3}", "or a list of names"),
        ("devices.arm_drive.signals={joint_position={a=1}}", "or a list of names"),
        ('devices.arm_drive.signals={joint_position="Position1"}', "is mapped more than once"),
        ('devices.arm_drive.mode_values={torque="x"}', "a whole number"),
        (
            "devices.arm_drive.mode_values={torque=2}",
            "has the number 2, but another name has the same",
        ),
        ("devices.arm_drive.mode_values={torque=99}", "holds 7 at most"),
        ("devices.arm_drive.life_cycle_values={active=1}", "two states have the same number"),
        ("facility.arm_watchdog_cycle=3", "did you mean 'arm_watchdog_cycles'"),
        (
            "devices.arm_drive.parameters.torque_rate_limit=-1",
            "torque_rate_limit is -1 N.m/s; more than 0 N.m/s is expected",
        ),
        ("devices.arm_drive.parameters.joint_effort_limit=0", "joint_effort_limit is 0 N.m"),
        ("devices.arm_drive.parameters.lost_consecutive=0", "lost_consecutive is 0"),
        ("devices.arm_drive.parameters.lost_consecutive=1.5", "a whole number is expected"),
        ("devices.arm_drive.parameters.lost_in_window=1e299", "at most 1e+06"),
        ("devices.arm_drive.parameters.ramp_down_time=-1", "ramp_down_time is -1 s"),
        ("devices.arm_drive.parameters.ramp_down_time=1e9", "at most 60"),
        ("devices.arm_drive.parameters.joint_limit_margin=-1", "joint_limit_margin is -1 rad"),
        ("devices.arm_drive.parameters.state_age_limit=-1", "state_age_limit is -1 s"),
        ("devices.arm_drive.parameters.configure_timeout=1e300", "finite|at most 3600"),
    ],
)
def test_an_invalid_setting_is_rejected(
    setting: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, error = run_command(
        capsys, "hil", "facility", "--no-view", "--out", str(tmp_path), "--set", setting
    )
    assert code == 2
    assert re.search(sentence.replace("+", "[+]"), error), error
    if "parameters" not in setting:  # the facility does not read these parameters
        code, other = run_command(capsys, "facility", "facility", "--set", setting)
        if "bus" not in setting and "e2e" not in setting:
            assert code == 2
            assert re.search(sentence.replace("+", "[+]"), other), other


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("hil", "multirate_passive"), "at least one device for the loop is expected"),
        (("facility", "multirate_passive"), "a virtual facility needs at least one such device"),
        (
            ("facility", "facility", "--set", "facility.arm_watchdog_cycle=3"),
            "did you mean 'arm_watchdog_cycles'",
        ),
        (("facility", "facility", "--set", "facility.arm_watchdog_cycles=0"), "greater than zero"),
        (
            ("facility", "facility", "--set", "facility.base_jump_m=true"),
            "a number greater than zero",
        ),
        (("hil", "nothing"), "there is no scenario 'nothing'"),
        (
            ("hil", "facility", "--set", "exchange=parallel"),
            "a device responds within the same instant; 'sequential' is expected",
        ),
    ],
)
def test_an_invalid_scenario_is_rejected(
    arguments: tuple[str, ...], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, error = run_command(capsys, *arguments, "--out", str(tmp_path))
    assert code == 2
    assert sentence in error


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"left_out": "Q3"}, "lacks the signal 'Q3' of signals.joint_position"),
        ({"state_size": 50}, "has 50 bytes, which is not a CAN FD frame size"),
        ({"state_size": 24}, "cannot be used"),
        ({"activation": "explicit"}, "so the arm itself cannot reject a late activation"),
        (
            {"torque_scale": 0.001},
            r"signal C1 holds -32.768 to 32.767 N.m, but the robot needs -176 to 176 N.m",
        ),
    ],
)
def test_a_dbc_that_does_not_fit_the_robot_is_rejected(
    changed: dict[str, object], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = own_dbc(tmp_path, **changed)  # type: ignore[arg-type]
    code, error = run_command(capsys, "hil", path, "--no-view", "--out", str(tmp_path / "out"))
    assert code == 2
    assert sentence in error


def test_a_missing_arm_is_reported(tmp_path: Path) -> None:
    with rig(tmp_path) as bench:
        loop = bench.hil("devices.arm_drive.parameters.configure_timeout=0.5")
        assert loop.finish() == 2
        assert re.search(
            r"arm_drive on CAN local:test-\S+ sends no description frame within 0.5 s: is the arm",
            loop.text,
        )


# Errors that are found by comparison with the facility


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Rig, Process]]:
    """One facility for all tests of this section. None of them may move it."""
    with rig(tmp_path_factory.mktemp("mistakes")) as made:
        facility = made.facility(*PATIENT_FACILITY, "facility.forget_after_s=0.2")
        yield made, facility
        report = made.facility_report(facility)
        assert not [
            event
            for device in ("arm_drive", "base_robot")
            for event in events(report, device)
            if "-> active" in event
        ]


@pytest.mark.parametrize(
    ("setting", "sentence"),
    family(
        [
            (
                "manipulator_controller.joint_effort_limit=[176, 176, 100, 100, 38, 40]",
                r"the joint effort limit of joint 6 is 38 N.m, but the scenario's robot has 40 N.m",
            ),
            (
                "devices.arm_drive.parameters.joint_velocity_limit=3.0",
                r"the joint velocity limit of joint 1 is 1.92 rad/s, but the scenario's robot has 3 rad/s",
            ),
            (
                "manipulator_controller.joint_upper_limit=2.5",
                r"the joint upper limit of joint 1 is 2.967 rad, but the scenario's robot has 2.5 rad",
            ),
            (
                "satellite.base_position=[0.0, 0.0, 0.0]",
                r"is at \[0.0400, 0.0000, 0.0800\] m.*starts at \[0.0000, 0.0000, 0.0000\] m.*: the distance is 0.089\d m",
            ),
            (
                "satellite.base_orientation=[0.0, 0.0, 0.0, 1.0]",
                r"is at .*roll (10.00|9.99)\d, .*starts at .*roll 0.000, .*: the distance is .* and 1?\d.\d+ deg,",
            ),
            (
                "reference_trajectory.start_joint_position=[0.1, -0.5, 1.4, 0.9, 0.0, 0.0]",
                r"joint \d is at -?[0-9.]+ rad, the scenario starts at -?[0-9.]+ rad, and the largest allowed distance is 0.02 rad",
            ),
            (
                "devices.base_robot.parameters.start_orientation=[0.0, 0.0, 0.0, 0.0]",
                "start_orientation is all zero",
            ),
            (
                "devices.base_robot.parameters.approach_speed=[0.0, 0.1]",
                "approach_speed is 0; more than 0 is expected",
            ),
            ("devices.base_robot.parameters.age_limit=-1", "age_limit is -1 s"),
            (
                "devices.base_robot.parameters.cycle=0.0045",
                r"the cycle of 0.0045 s is not a multiple of the step of 0.001 s",
            ),
        ],
        1,
    ),
)
def test_a_device_that_does_not_match_the_scenario_is_rejected_with_both_values(
    bench: tuple[Rig, Process], setting: str, sentence: str
) -> None:
    rigged, _ = bench
    loop = rigged.hil(setting)
    assert loop.finish() == 2, loop.text
    assert re.search(sentence, " ".join(loop.output)), loop.text


@pytest.mark.slow
def test_an_arm_of_seven_joints_is_rejected_for_a_robot_of_six(
    bench: tuple[Rig, Process], tmp_path: Path
) -> None:
    """Another arm on the channel sends the description frame first."""
    from freeflyer_adapters.arm.frames import ArmFrames, FrameMapping
    from freeflyer_adapters.can.link import Sender, open_bus

    rigged, _ = bench
    with rig(tmp_path) as alone:
        frames = ArmFrames(FrameMapping(), 7)
        assert frames.description is not None
        bus = open_bus("local", alone.channel, True, [frames.command], {})
        sender = Sender(bus, frames.description)
        loop = alone.hil(f'devices.base_robot.connect=["{rigged.endpoint}"]')
        try:
            while loop.popen.poll() is None:
                sender.send({"joint_count": (7.0,), "cycle_time": (0.001,)})
                loop.popen.poll()
                _pause()
        finally:
            bus.shutdown()
        assert loop.finish() == 2
        assert "has 7 joints, but the scenario's robot has 6" in loop.text


def _pause() -> None:
    import time

    time.sleep(0.01)


def test_a_port_in_use_is_reported(bench: tuple[Rig, Process], tmp_path: Path) -> None:
    rigged, _ = bench
    with rig(tmp_path) as other:
        other.endpoint = rigged.endpoint
        second = other.start("facility", "facility", *other.links)
        assert second.finish() == 2
        assert "Address already in use" in second.text


@pytest.mark.slow
def test_the_start_pose_is_approached_if_requested(tmp_path: Path) -> None:
    with rig(tmp_path) as bench:
        facility = bench.facility(*PATIENT_FACILITY, "base_robot.true_position=[0.05, 0.0, 0.08]")
        loop = bench.hil(
            "devices.base_robot.parameters.approach=true",
            "devices.base_robot.parameters.approach_speed=[0.05, 0.1]",
            *PATIENT_LOOP,
            "stop_s=0.5",
        )
        assert loop.finish() == 0, loop.text
        start = bench.record().filter(like="base_robot.base_position").iloc[0].to_numpy()
        assert abs(start[0] - 0.04) < 0.005
        facility.send(signal.SIGINT)
        facility.finish()
