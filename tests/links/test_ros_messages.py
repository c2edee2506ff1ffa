"""ROS messages compared with `rosbags`, and attachments compared with zenoh-ext.

Both are independent implementations.
"""

from __future__ import annotations

import contextlib
import struct

import numpy as np
import pytest
import zenoh.ext
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from freeflyer_adapters.base import rmw_zenoh, ros_messages
from freeflyer_adapters.base.rmw_zenoh import Attachment, AttachmentError, read_attachment
from freeflyer_adapters.base.ros_messages import MessageError, OdometryWriter, read
from freeflyer_adapters.foundation import pose

STORE = get_typestore(Stores.ROS2_JAZZY)
NAME = "nav_msgs/msg/Odometry"
numbers = st.floats(-1e6, 1e6)
vectors = {size: arrays.arrays(float, size, elements=numbers) for size in (3, 4, 6)}
frames = st.text(st.characters(min_codepoint=32, max_codepoint=0x2FF), max_size=20)


@given(frames, frames, st.integers(0, 2**62), vectors[3], vectors[4], vectors[6])
def test_rosbags_decodes_our_messages(
    frame: str,
    child: str,
    stamp: int,
    position: np.ndarray,
    orientation: np.ndarray,
    velocity: np.ndarray,
) -> None:
    stamp %= 2**31 * 1_000_000_000
    data = OdometryWriter(frame, child).write(stamp, position, orientation, velocity)
    found = STORE.deserialize_cdr(data, NAME)
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == divmod(stamp, 1_000_000_000)
    assert (found.header.frame_id, found.child_frame_id) == (frame, child)
    p, o = found.pose.pose.position, found.pose.pose.orientation
    assert [p.x, p.y, p.z, o.x, o.y, o.z, o.w] == [*position, *orientation]
    linear, angular = found.twist.twist.linear, found.twist.twist.angular
    assert [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z] == list(velocity)


@given(
    frames,
    frames,
    st.booleans(),
    vectors[3],
    vectors[4],
    vectors[6],
    arrays.arrays(float, 36, elements=numbers),
)
def test_messages_of_rosbags_are_decoded(
    frame: str,
    child: str,
    little: bool,
    position: np.ndarray,
    orientation: np.ndarray,
    velocity: np.ndarray,
    covariance: np.ndarray,
) -> None:
    t = STORE.types
    message = t[NAME](
        header=t["std_msgs/msg/Header"](
            stamp=t["builtin_interfaces/msg/Time"](sec=7, nanosec=9), frame_id=frame
        ),
        child_frame_id=child,
        pose=t["geometry_msgs/msg/PoseWithCovariance"](
            pose=t["geometry_msgs/msg/Pose"](
                position=t["geometry_msgs/msg/Point"](*position),
                orientation=t["geometry_msgs/msg/Quaternion"](*orientation),
            ),
            covariance=covariance,
        ),
        twist=t["geometry_msgs/msg/TwistWithCovariance"](
            twist=t["geometry_msgs/msg/Twist"](
                linear=t["geometry_msgs/msg/Vector3"](*velocity[:3]),
                angular=t["geometry_msgs/msg/Vector3"](*velocity[3:]),
            ),
            covariance=covariance,
        ),
    )
    found = read(bytes(STORE.serialize_cdr(message, NAME, little_endian=little)))
    assert (found.stamp, found.frame, found.child_frame) == (7_000_000_009, frame, child)
    assert np.array_equal(found.position, position)
    assert np.array_equal(found.orientation, orientation)
    assert np.array_equal(found.velocity, velocity)


def test_type_name_and_hash_match_the_definition() -> None:
    assert STORE.hash_rihs01(NAME) == ros_messages.TYPE_HASH
    package, kind, name = NAME.split("/")
    assert f"{package}::{kind}::dds_::{name}_" == ros_messages.TYPE_NAME


GOOD = OdometryWriter("inertial", "base").write(
    1, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(6)
)


@given(st.binary(max_size=900) | st.builds(lambda cut: GOOD[:cut], st.integers(0, len(GOOD) - 1)))
def test_bytes_that_are_not_a_message_are_rejected(data: bytes) -> None:
    with pytest.raises(MessageError):
        read(data)


@given(st.integers(0, len(GOOD) - 1), st.integers(0, 255))
def test_a_message_with_one_changed_byte_is_either_read_or_rejected(place: int, value: int) -> None:
    data = bytearray(GOOD)
    data[place] = value
    with contextlib.suppress(MessageError):
        found = read(bytes(data))
        assert found.position.shape == (3,)


@given(
    st.integers(-(2**63), 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16)
)
def test_the_attachment_has_the_same_bytes_as_zenohs_serialiser(
    sequence: int, stamp: int, gid: bytes
) -> None:
    ours = Attachment(sequence, stamp, gid).pack()
    theirs = zenoh.ext.z_serialize((zenoh.ext.Int64(sequence), zenoh.ext.Int64(stamp), gid))
    assert ours == theirs.to_bytes()
    assert read_attachment(ours) == Attachment(sequence, stamp, gid)


@given(st.binary(max_size=60))
def test_bytes_that_are_not_an_attachment_are_rejected(data: bytes) -> None:
    if len(data) == 33 and data[16] == 16:
        data = data[:-1]
    with pytest.raises(AttachmentError):
        read_attachment(data)


def test_keys_match_rmw_zenoh() -> None:
    """The examples of the design document of ros2/rmw_zenoh, with the topic and type used here."""
    key = rmw_zenoh.topic_key(
        0, "/base_robot/measured", ros_messages.TYPE_NAME, ros_messages.TYPE_HASH
    )
    assert key == f"0/base_robot/measured/nav_msgs::msg::dds_::Odometry_/{ros_messages.TYPE_HASH}"
    token = rmw_zenoh.liveliness_token(
        domain=2,
        session="aac3178e146ba6f1fc6e6a4085e77f21",
        entity=10,
        kind="MP",
        node="talker",
        topic="/base_robot/measured",
        type_name=ros_messages.TYPE_NAME,
        type_hash=ros_messages.TYPE_HASH,
    )
    assert token == (
        "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/talker/%base_robot%measured/nav_msgs::msg::dds_::Odometry_/"
        f"{ros_messages.TYPE_HASH}/2::,1:,:,:,,"
    )
    assert rmw_zenoh.session_of(token) == "aac3178e146ba6f1fc6e6a4085e77f21"


def test_a_stamp_beyond_ros_time_raises() -> None:
    with pytest.raises(struct.error):
        OdometryWriter("a", "b").write(2**31 * 1_000_000_000, np.zeros(3), np.zeros(4), np.zeros(6))


@given(vectors[4].filter(lambda q: float(q @ q) > 1.0), vectors[6])
def test_rotated_twists_match_scipy_and_the_inverse_rotation(
    q: np.ndarray, twist: np.ndarray
) -> None:
    q = q / np.linalg.norm(q)
    rotated = pose.twist_rotated(q, twist)
    size = 1.0 + np.abs(twist).max()
    assert rotated == pytest.approx(
        Rotation.from_quat(q).apply(twist.reshape(2, 3)).ravel(), abs=1e-12 * size
    )
    assert pose.twist_rotated(q, rotated, back=True) == pytest.approx(twist, abs=1e-12 * size)


@given(
    vectors[4].filter(lambda q: float(q @ q) > 1.0), vectors[4].filter(lambda q: float(q @ q) > 1.0)
)
def test_the_angle_between_two_orientations_matches_scipy(q: np.ndarray, r: np.ndarray) -> None:
    _, angle = pose.distance(np.zeros(3), q, np.zeros(3), r)
    assert angle == pytest.approx(
        (Rotation.from_quat(q) * Rotation.from_quat(r).inv()).magnitude(), abs=1e-7
    )
