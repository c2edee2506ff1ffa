"""Topic keys, liveliness tokens and attachments of ROS 2's rmw_zenoh_cpp.

The layout is from ros2/rmw_zenoh (docs/design.md, attachment_helpers.cpp, liveliness_utils.cpp).
The tests compare the bytes of an attachment with the bytes that the serialiser of zenoh-ext writes.
"""

from __future__ import annotations

import hashlib
import re
import struct
from dataclasses import dataclass

GID_BYTES = 16
ATTACHMENT = struct.Struct(f"<qqB{GID_BYTES}s")
"""Sequence number, source time stamp [ns since the epoch], length of the GID, GID."""
TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
NO_PUBLISHER = "nobody"
"""This text replaces the GID in the obedience token if no publisher is in command."""
QOS_SENSOR_DATA = "2::,1:,:,:,,"
"""Best effort, volatile, keep last 1. All other settings are the defaults of ROS 2."""


class AttachmentError(ValueError):
    """The bytes are not an attachment of rmw_zenoh."""


@dataclass(frozen=True)
class Attachment:
    sequence: int
    stamp: int
    gid: bytes

    def pack(self) -> bytes:
        return ATTACHMENT.pack(self.sequence, self.stamp, GID_BYTES, self.gid)


def read_attachment(data: bytes) -> Attachment:
    """Unpack an attachment. Raises AttachmentError if a length is wrong."""
    if len(data) != ATTACHMENT.size:
        raise AttachmentError(f"an attachment of {len(data)} bytes; {ATTACHMENT.size} are expected")
    sequence, stamp, length, gid = ATTACHMENT.unpack(data)
    if length != GID_BYTES:
        raise AttachmentError(f"a GID of {length} bytes; {GID_BYTES} are expected")
    return Attachment(sequence, stamp, gid)


def topic_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """Return the key expression of the samples of a topic."""
    return f"{domain}/{topic.strip('/')}/{type_name}/{type_hash}"


def mangled(name: str) -> str:
    """Return a ROS name as rmw_zenoh writes it in liveliness tokens."""
    return name.replace("/", "%")


def liveliness_token(
    *,
    domain: int,
    session: str,
    entity: int,
    kind: str,
    node: str,
    topic: str,
    type_name: str,
    type_hash: str,
) -> str:
    """Return the key of the liveliness token that announces a publisher or a subscription.

    `session`: Zenoh id of the session. `entity`: number of the publisher or subscription in this
    session. `kind`: MP for a publisher, MS for a subscription. `node`: name of the ROS node.
    """
    parts = ["@ros2_lv", str(domain), session, "0", str(entity), kind, "%", "%", node]
    return "/".join(
        [*parts, mangled("/" + topic.strip("/")), mangled(type_name), type_hash, QOS_SENSOR_DATA]
    )


def obedience_token(domain: int, topic: str, gid: str) -> str:
    """Return the key of the token by which a base robot reports the publisher in command.

    The publisher in command is the publisher from which the base robot accepts set points. `gid` is
    its GID, or NO_PUBLISHER. ROS 2 does not have this token; it is an addition of this project.
    """
    return f"freeflyer/obeys/{domain}/{mangled(topic.strip('/'))}/{gid}"


def commander_token(domain: int, topic: str, name: str) -> str:
    """Return the key of the token by which a base robot reports one of its commanders.

    A commander is a controller that may send set points. `name` is the common name of its
    certificate. ROS 2 does not have this token; it is an addition
    of this project.
    """
    return f"freeflyer/commanders/{domain}/{mangled(topic.strip('/'))}/{name}"


def session_of(token: str) -> str:
    """Return the Zenoh id of the session that declared a token."""
    return token.split("/")[2] if token.count("/") > 2 else token


def gid_of(token: str) -> bytes:
    """Return a unique GID (16 bytes) for the publisher with this token.

    In this project, the GID is a hash of the token. Peers do not check how a GID was computed.
    """
    return hashlib.blake2b(token.encode(), digest_size=GID_BYTES).digest()
