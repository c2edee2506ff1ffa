"""Messages of a recording, read by rosbags, the mcap reader and its ROS 2 decoder."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from loops import PARTS, START, TICK, head, recording, rows
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from freeflyer_adapters import read_recording
from freeflyer_adapters.recording.ros_definitions import (
    DEFINITIONS,
    field_names,
    full_text,
    message_name,
)
from freeflyer_adapters.recording.topics import topics

COUNT = 130


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("recording") / "made.mcap"
    made.write_bytes(recording(COUNT))
    return made


@pytest.mark.parametrize("kind", list(DEFINITIONS))
def test_definitions_are_those_of_ros(kind: str) -> None:
    package, name = kind.split("/")
    ours = get_types_from_msg(full_text(DEFINITIONS[kind]), f"{package}/msg/{name}")
    theirs = get_typestore(Stores.ROS2_JAZZY).fielddefs
    for message, fields in ours.items():
        assert fields[1] == theirs[message][1], message


def test_every_topic_has_the_documented_message_type(path: Path) -> None:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    found = {
        channel.topic: summary.schemas[channel.schema_id].name
        for channel in summary.channels.values()
    }
    assert found == {
        "/loop": "freeflyer_cosim/msg/Loop",
        "/arm": "freeflyer_cosim/msg/Arm",
        "/arm/joint_states": "sensor_msgs/msg/JointState",
        "/base_robot": "freeflyer_cosim/msg/BaseRobot",
        "/base_robot/base/odometry": "nav_msgs/msg/Odometry",
        "/end_effector": "freeflyer_cosim/msg/EndEffector",
        "/end_effector/pose": "geometry_msgs/msg/PoseStamped",
        "/controller": "freeflyer_cosim/msg/Controller",
        "/controller/end_effector/wrench": "geometry_msgs/msg/WrenchStamped",
    }
    assert summary.statistics is not None
    assert summary.statistics.message_count == COUNT * len(found)
    assert summary.statistics.message_start_time == START
    assert summary.statistics.message_end_time == START + (COUNT - 1) * TICK


def test_the_mcap_reader_finds_every_message_with_a_correct_checksum(path: Path) -> None:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages = list(reader.iter_messages())
        assert len(messages) == COUNT * 9
        assert [m.log_time for _, _, m in messages] == sorted(m.log_time for _, _, m in messages)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        assert metadata["freeflyer.stop"]["reason"] == "it was enough"
        assert metadata["freeflyer.run"]["scenario"] == "made"
        assert [a.name for a in reader.iter_attachments()] == ["origin.json"]


def test_rosbags_deserialises_every_message_with_the_written_numbers(
    path: Path,
) -> None:
    made = head(path)
    values = rows(COUNT, made.width).values
    part = {
        signal.name: values[:, signal.first : signal.first + signal.size] for signal in made.signals
    }
    seen: dict[str, int] = {}
    with AnyReader([path]) as reader:
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            i = seen[connection.topic] = seen.get(connection.topic, -1) + 1
            assert stamp == START + i * TICK
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
            match connection.topic:
                case "/arm/joint_states":
                    assert message.name == ["joint_1", "joint_2"]
                    assert np.array_equal(message.position, part["arm.joint_position"][i])
                    assert np.array_equal(message.effort, part["arm.joint_torque"][i])
                    assert message.velocity.size == 0
                case "/base_robot/base/odometry":
                    assert (message.header.frame_id, message.child_frame_id) == ("inertial", "base")
                    q = message.pose.pose.orientation
                    rotation = Rotation.from_quat([q.x, q.y, q.z, q.w])
                    twist = message.twist.twist
                    for vector, where in (
                        (twist.linear, slice(0, 3)),
                        (twist.angular, slice(3, 6)),
                    ):
                        in_body = rotation.inv().apply(part["base_robot.base_velocity"][i, where])
                        assert [vector.x, vector.y, vector.z] == pytest.approx(in_body, abs=1e-12)
                case "/end_effector/pose":
                    p = message.pose.position
                    assert [p.x, p.y, p.z] == part["end_effector.position"][i].tolist()
                case "/controller":
                    assert message.odd_name_2 == part["controller.Odd name (2)"][i, 0]
                case "/controller/end_effector/wrench":
                    w = message.wrench.torque
                    assert [w.x, w.y, w.z] == part["controller.end_effector_wrench"][i, 3:].tolist()
                case "/loop":
                    assert (message.instant, message.time) == (i, pytest.approx(i * 1e-3))
                    assert message.arm_state == values[i, -2]
    assert set(seen.values()) == {COUNT - 1}


def test_the_ros_2_decoder_of_mcap_decodes_every_message(path: Path) -> None:
    values = rows(COUNT, head(path).width).values
    count = 0
    with path.open("rb") as file:
        for message in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            if message.channel.topic == "/base_robot":
                assert (
                    list(message.decoded_message.base_position) == values[count // 9, 4:7].tolist()
                )
            count += 1
    assert count == COUNT * 9


def test_the_pandas_table_of_a_recording_has_every_element_bit_for_bit(path: Path) -> None:
    frame = read_recording(path)
    made = head(path)
    expected = rows(COUNT, made.width)
    names = ["time", *(column for signal in made.signals for column in signal.columns), *made.loop]
    assert list(frame.columns) == [*names, "monotonic_ns", "instant", "wall_ns"]
    assert np.array_equal(frame[names[1:]].to_numpy(), expected.values)
    assert np.array_equal(frame["wall_ns"].to_numpy(), expected.times[:, 0])
    assert frame["time"].iloc[-1] == pytest.approx((COUNT - 1) * 1e-3)
    assert frame.attrs["units"]["arm.joint_torque[2]"] == "N.m"
    assert frame.attrs["stop"]["reason"] == "it was enough"


def test_invalid_names_are_converted_to_valid_ros_names() -> None:
    assert field_names(["a.b", "a_b", "Header", "1st", "x__y_", "header"]) == [
        "a_b",
        "a_b_2",
        "header_2",
        "f_1st",
        "x_y",
        "header_3",
    ]
    assert message_name("base_robot") == "BaseRobot"
    assert message_name("7 arms") == "M7Arms"


def test_a_signal_with_a_matching_name_but_another_unit_has_no_ros_message(
    tmp_path: Path,
) -> None:
    made = head(tmp_path)
    changed = [
        replace(s, units=("1",) * s.size) if s.name.endswith("wrench") else s for s in made.signals
    ]
    found = {topic.name for topic in topics(made, changed)}
    assert "/controller/end_effector/wrench" not in found
    assert {f"/{name.split('.')[0]}" for name in PARTS} <= found


def test_definitions_are_repeated_for_files_with_a_damaged_start() -> None:
    data = recording(6000, 0.5)
    assert data.count(b"freeflyer_cosim/msg/Arm\x07") >= 2
    with BytesIO(data) as stream:
        assert len(list(make_reader(stream).iter_messages(topics=["/arm"]))) == 6000
