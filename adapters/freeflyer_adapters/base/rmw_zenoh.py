"""How ROS 2's rmw_zenoh_cpp names topics, announces itself and marks every sample, so that its nodes are peers of ours.

Layout from ros2/rmw_zenoh (docs/design.md, attachment_helpers.cpp, liveliness_utils.cpp); the bytes of the attachment are those
of zenoh-ext's serialiser, with which the tests compare them.
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
NOBODY = "nobody"
QOS_SENSOR_DATA = "2::,1:,:,:,,"
"""Best effort, volatile, keep last 1; all else as ROS 2's default."""


class AttachmentError(ValueError):
    """Bytes that are no attachment of rmw_zenoh."""


@dataclass(frozen=True)
class Attachment:
    sequence: int
    stamp: int
    gid: bytes

    def pack(self) -> bytes:
        return ATTACHMENT.pack(self.sequence, self.stamp, GID_BYTES, self.gid)


def read_attachment(data: bytes) -> Attachment:
    """AttachmentError if these are not its bytes."""
    if len(data) != ATTACHMENT.size:
        raise AttachmentError(f"an attachment of {len(data)} bytes; {ATTACHMENT.size} are expected")
    sequence, stamp, length, gid = ATTACHMENT.unpack(data)
    if length != GID_BYTES:
        raise AttachmentError(f"a GID of {length} bytes; {GID_BYTES} are expected")
    return Attachment(sequence, stamp, gid)


def topic_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """The key expression that carries a topic's samples."""
    return f"{domain}/{topic.strip('/')}/{type_name}/{type_hash}"


def mangled(name: str) -> str:
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
    """The key of the token that announces a publisher (kind MP) or a subscription (MS)."""
    parts = ["@ros2_lv", str(domain), session, "0", str(entity), kind, "%", "%", node]
    return "/".join(
        [*parts, mangled("/" + topic.strip("/")), mangled(type_name), type_hash, QOS_SENSOR_DATA]
    )


def obedience_token(domain: int, topic: str, whom: str) -> str:
    """Our own addition: the key of the token by which a base robot tells whose set points it takes (a GID, or NOBODY)."""
    return f"freeflyer/obeys/{domain}/{mangled(topic.strip('/'))}/{whom}"


def commander_token(domain: int, topic: str, name: str) -> str:
    """Our own addition: the key of the token by which a base robot tells that it lets a certificate of this name command."""
    return f"freeflyer/commanders/{domain}/{mangled(topic.strip('/'))}/{name}"


def session_of(token: str) -> str:
    """Whose token it is: the Zenoh id of its session."""
    return token.split("/")[2] if token.count("/") > 2 else token


def gid_of(token: str) -> bytes:
    """16 bytes that are an entity's own: rmw_zenoh takes a hash of its token; which hash it is, nobody compares."""
    return hashlib.blake2b(token.encode(), digest_size=GID_BYTES).digest()
