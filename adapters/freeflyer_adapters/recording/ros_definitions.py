"""Message definitions of ROS 2 for the schemas of a recording (encoding ros2msg).

A schema contains the definition of a message, then the definitions of the types of its fields.
Comments are omitted. Tests compare the fields and their order with the definitions in rosbags.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

PACKAGE = "freeflyer_cosim"
"""ROS package of the messages that are generated from a scenario."""
SEPARATOR = "=" * 80
PLAIN = frozenset({"float64", "int64", "uint64", "int32", "uint32", "string"})

DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/Accel": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/TwistStamped": "std_msgs/Header header\ngeometry_msgs/Twist twist",
    "geometry_msgs/AccelStamped": "std_msgs/Header header\ngeometry_msgs/Accel accel",
    "geometry_msgs/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    "nav_msgs/Odometry": (
        "std_msgs/Header header\nstring child_frame_id\n"
        "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist"
    ),
    "sensor_msgs/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
    ),
}


def full_text(definition: str) -> str:
    """Return the text of a schema: `definition`, then the definitions of all types in it.

    These definitions can contain further types. Each type is defined only once in the text.
    """
    found: dict[str, str] = {}
    waiting = [definition]
    while waiting:
        for line in waiting.pop().splitlines():
            kind = line.split("#")[0].strip().split(" ")[0].split("[")[0]
            if kind and kind not in PLAIN and kind not in found:
                found[kind] = DEFINITIONS[kind]
                waiting.append(DEFINITIONS[kind])
    return "".join(
        [
            definition + "\n",
            *(f"{SEPARATOR}\nMSG: {kind}\n{text}\n" for kind, text in found.items()),
        ]
    )


def message_name(text: str) -> str:
    """Convert a component name to a ROS message name, for example arm_drive to ArmDrive."""
    parts = re.findall(r"[A-Za-z0-9]+", text)
    return "M" * (not parts or not parts[0][0].isalpha()) + "".join(
        part[0].upper() + part[1:] for part in parts
    )


def field_names(texts: Sequence[str]) -> list[str]:
    """Convert each of `texts` to a valid ROS field name. The returned names are unique."""
    found: list[str] = []
    for text in texts:
        name = "_".join(re.findall(r"[a-z0-9]+", text.lower()))
        name = name if name[:1].isalpha() else f"f_{name}".rstrip("_")
        number, unique = 2, name
        while unique in found or unique == "header":
            unique, number = f"{name}_{number}", number + 1
        found.append(unique)
    return found
