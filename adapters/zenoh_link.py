"""A Zenoh session that listens where it is told to and nowhere else, and one topic out and one in over it, freshest only."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import zenoh

from adapters import rmw_zenoh, ros_messages
from adapters.device import DeviceError
from adapters.link_options import LinkOptions
from adapters.pose import twist_rotated
from adapters.rmw_zenoh import Attachment, AttachmentError
from adapters.ros_messages import MessageError, Odometry, OdometryWriter
from cosim.component import Array


def open_session(connect: Sequence[str], listen: Sequence[str], subject: str) -> zenoh.Session:
    """A peer. DeviceError if the endpoints cannot be used."""
    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        "connect/endpoints": list(connect),
        "connect/timeout_ms": 2000,
        "connect/exit_on_failure": False,
        "listen/endpoints": list(listen),
        "listen/exit_on_failure": True,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
    }.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise DeviceError(f"{subject}: Zenoh refuses {key} = {value!r}: {_said(error)}") from error
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise DeviceError(
            f"{subject}: a Zenoh session (listening on {', '.join(listen)}, connecting to {', '.join(connect) or 'nobody'}) cannot be "
            f"opened: {_said(error)}"
        ) from error


def _said(error: Exception) -> str:
    """Zenoh's reason without its source lines."""
    return " ".join(str(error).split(" at ")[0].split())[:200]


@dataclass
class Received:
    """The freshest sample, and when it came [ns of CLOCK_MONOTONIC]."""

    odometry: Odometry
    attachment: Attachment
    arrived: int


@dataclass
class Counts:
    accepted: int = 0
    skipped: int = 0
    """Sequence numbers that were never seen here: lost, or overwritten by a fresher sample."""
    malformed: int = 0
    stale: int = 0
    """Repeated, reordered or older than the one before."""
    strangers: int = 0
    """From another publisher than the one in use."""
    last_fault: str = ""


@dataclass
class OdometryLink:
    """Publishes Odometry on one topic and reads the freshest from another."""

    session: Any
    options: LinkOptions
    out_topic: str
    in_topic: str
    counts: Counts = field(default_factory=Counts)

    def __post_init__(self) -> None:
        o = self.options
        self._session_id = str(self.session.zid())
        keys = {t: rmw_zenoh.topic_key(o.domain, t, ros_messages.TYPE_NAME, ros_messages.TYPE_HASH) for t in self._topics}
        self._subscriber = self.session.declare_subscriber(keys[self.in_topic], zenoh.handlers.RingChannel(1))
        self._publisher = self.session.declare_publisher(
            keys[self.out_topic],
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )
        tokens = [self._token(self.out_topic, "MP", 1), self._token(self.in_topic, "MS", 2)]
        self._tokens = [self.session.liveliness().declare_token(token) for token in tokens]
        self._gid = rmw_zenoh.gid_of(tokens[0])
        self._writer = OdometryWriter(o.frame, o.child_frame)
        self._sequence = 0
        self._source: bytes | None = None
        self._last: Attachment | None = None

    @property
    def _topics(self) -> tuple[str, str]:
        return self.out_topic, self.in_topic

    def _token(self, topic: str, kind: str, entity: int) -> str:
        return rmw_zenoh.liveliness_token(
            domain=self.options.domain,
            session=self._session_id,
            entity=entity,
            kind=kind,
            node=self.options.node,
            topic=topic,
            type_name=ros_messages.TYPE_NAME,
            type_hash=ros_messages.TYPE_HASH,
        )

    @property
    def identity(self) -> str:
        return self._session_id

    def other_publishers(self, topic: str) -> list[str]:
        """Sessions, other than this one, that announce to publish a topic."""
        name = rmw_zenoh.mangled("/" + topic.strip("/"))
        key = f"@ros2_lv/{self.options.domain}/*/*/*/MP/*/*/*/{name}/**"
        found = set()
        for reply in self.session.liveliness().get(key, timeout=1.0):
            if reply.ok is not None:
                found.add(rmw_zenoh.session_of(str(reply.ok.key_expr)))
        return sorted(found - {self._session_id})

    def publish(self, position: Array, orientation: Array, velocity: Array) -> None:
        """Pose of B in I and twist in I (which goes out in B)."""
        stamp = time.time_ns()
        self._sequence += 1
        payload = self._writer.write(stamp, position, orientation, twist_rotated(orientation, velocity, back=True))
        self._publisher.put(payload, attachment=Attachment(self._sequence, stamp, self._gid).pack())

    def receive(self) -> Received | None:
        """The freshest sample since the last call, if there is one that can be used; never waits."""
        sample = self._subscriber.try_recv()
        if sample is None:
            return None
        try:
            attachment = rmw_zenoh.read_attachment(b"" if sample.attachment is None else sample.attachment.to_bytes())
            odometry = ros_messages.read(sample.payload.to_bytes())
        except (AttachmentError, MessageError) as error:
            self.counts.malformed += 1
            self.counts.last_fault = str(error)
            return None
        if self._source is not None and attachment.gid != self._source:
            self.counts.strangers += 1
            self.counts.last_fault = f"a sample from {attachment.gid.hex()}, {self._source.hex()} is in use"
            return None
        last = self._last
        if last is not None and (attachment.sequence <= last.sequence or attachment.stamp < last.stamp):
            self.counts.stale += 1
            self.counts.last_fault = f"sequence number {attachment.sequence} after {last.sequence}"
            return None
        if last is not None:
            self.counts.skipped += attachment.sequence - last.sequence - 1
        self._source, self._last = attachment.gid, attachment
        self.counts.accepted += 1
        return Received(odometry, attachment, time.monotonic_ns())

    def forget_source(self) -> None:
        """Listen to whoever publishes next."""
        self._source = self._last = None

    def close(self) -> None:
        for token in self._tokens:
            with contextlib.suppress(zenoh.ZError):
                token.undeclare()
        for declared in (self._publisher, self._subscriber):
            with contextlib.suppress(zenoh.ZError):
                declared.undeclare()
