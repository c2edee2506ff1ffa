"""One topic out and one in over a Zenoh session, freshest only."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zenoh

from freeflyer.component import Array
from freeflyer_adapters import outside
from freeflyer_adapters.base import rmw_zenoh, ros_messages
from freeflyer_adapters.base.options import LinkOptions
from freeflyer_adapters.base.rmw_zenoh import Attachment, AttachmentError
from freeflyer_adapters.base.ros_messages import MessageError, Odometry, OdometryWriter
from freeflyer_adapters.base.sealed_odometry import checksum, is_intact, is_sealable, is_sealed, sealed
from freeflyer_adapters.base.session import said
from freeflyer_adapters.device import DeviceError
from freeflyer_adapters.pose import twist_rotated

LARGEST = 1e4
"""Of a position [m] or a velocity [m/s, rad/s] in a facility; what is beyond is none."""


def is_usable(odometry: Odometry) -> bool:
    """Numbers that can be a pose and a twist, and an orientation that is one."""
    # In this order NaN fails the comparison.
    possible = (np.abs(odometry.position) < LARGEST).all() and (np.abs(odometry.velocity) < LARGEST).all()
    return bool(possible) and 0.98 < float(odometry.orientation @ odometry.orientation) < 1.02


@dataclass
class Received:
    """The freshest sample, and when it was read [ns of CLOCK_MONOTONIC]."""

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
    failed: int = 0
    """Samples that Zenoh did not take for sending."""
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
        self._outside = outside.present()
        self._session_id = str(self.session.zid())
        keys = {t: rmw_zenoh.topic_key(o.domain, t, ros_messages.TYPE_NAME, ros_messages.TYPE_HASH) for t in self._topics}
        try:
            self._declare(keys)
        except zenoh.ZError as error:
            raise DeviceError(f"Zenoh refuses a topic: {said(error)}") from error
        self._writer = OdometryWriter(o.frame, o.child_frame)
        self._sequence = 0
        self._source: bytes | None = None
        self._last: Attachment | None = None
        self._is_sealed = False
        """Whether the source's samples have a checksum; then all of them have."""
        self._told = ""
        self._obedience: Any = None
        self._obeyed_tokens: Any = None

    def _declare(self, keys: Mapping[str, str]) -> None:
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
    def gid(self) -> str:
        """By which samples of this publisher are known."""
        return self._gid.hex()

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
        stamp = self._outside.time_ns()
        self._sequence += 1
        twist = twist_rotated(orientation, velocity, back=True)
        while True:
            attachment = Attachment(self._sequence, stamp, self._gid).pack()
            payload = self._writer.write(stamp, position, orientation, twist)
            if is_sealable(checksum(payload, attachment)):
                break
            stamp += 1
        self.put(sealed(payload, attachment), attachment)

    def put(self, payload: bytes, attachment: bytes) -> None:
        """A sample into the session; one that it does not take is counted."""
        try:
            self._publisher.put(payload, attachment=attachment)
        except zenoh.ZError as error:
            self.counts.failed += 1
            self.counts.last_fault = said(error)

    def take(self) -> tuple[bytes, bytes] | None:
        """Payload and attachment of the freshest sample since the last call; never waits."""
        sample = self._subscriber.try_recv()
        if sample is None:
            return None
        return sample.payload.to_bytes(), b"" if sample.attachment is None else sample.attachment.to_bytes()

    def obeyed(self) -> str | None:
        """Whose set points the base robot takes: a GID, NOBODY, or None from one that does not tell."""
        key = rmw_zenoh.obedience_token(self.options.domain, self.options.setpoint_topic, "*")
        found = [
            str(reply.ok.key_expr).rsplit("/", 1)[1]
            for reply in self.session.liveliness().get(key, timeout=1.0)
            if reply.ok is not None
        ]
        # While the token changes there may be two; somebody's name says more than nobody's.
        return next((whom for whom in found if whom != rmw_zenoh.NOBODY), found[0] if found else None)

    def watch_obedience(self) -> None:
        """From now on `is_deserted` tells whether the base robot has ceased to obey."""
        key = rmw_zenoh.obedience_token(self.options.domain, self.options.setpoint_topic, self.gid)
        self._obeyed_tokens = self.session.liveliness().declare_subscriber(key, zenoh.handlers.FifoChannel(64))

    def is_deserted(self) -> bool:
        """Whether the base's word that it obeys this publisher has been withdrawn since the last call; never waits."""
        withdrawn = False
        while self._obeyed_tokens is not None and (news := self._obeyed_tokens.try_recv()) is not None:
            withdrawn = withdrawn or news.kind == zenoh.SampleKind.DELETE
        return withdrawn

    def tell_obeyed(self, active: bool) -> None:
        """Declare whose set points are taken, if that has changed: the source in use, while the base robot is `active`."""
        whom = self._source.hex() if active and self._source is not None else rmw_zenoh.NOBODY
        if whom != self._told:
            before, self._told = self._obedience, whom
            key = rmw_zenoh.obedience_token(self.options.domain, self.options.setpoint_topic, whom)
            self._obedience = self.session.liveliness().declare_token(key)
            if before is not None:
                before.undeclare()

    def receive(self, judge: Callable[[Odometry], bool]) -> Received | None:
        """The freshest sample since the last call, if there is one that can be used and `judge` agrees; never waits.

        The first such sample's publisher is the only one that is listened to from then on.
        """
        sample = self.take()
        if sample is None:
            return None
        payload, raw = sample
        if (is_sealed(payload) or self._is_sealed) and not is_intact(payload, raw):
            self.counts.malformed += 1
            self.counts.last_fault = "a sample that does not fit its checksum"
            return None
        try:
            attachment = rmw_zenoh.read_attachment(raw)
            odometry = ros_messages.read(payload)
        except (AttachmentError, MessageError) as error:
            self.counts.malformed += 1
            self.counts.last_fault = str(error)
            return None
        if self._source is not None and attachment.gid != self._source:
            self.counts.strangers += 1
            self.counts.last_fault = f"a sample from {attachment.gid.hex()}, {self._source.hex()} is in use"
            return None
        last = self._last
        if last is not None and (attachment.sequence <= last.sequence or attachment.stamp <= last.stamp):
            self.counts.stale += 1
            self.counts.last_fault = f"sequence number {attachment.sequence} after {last.sequence}, its stamp {(attachment.stamp - last.stamp) * 1e-9:.6g} s later"
            return None
        if not judge(odometry):
            self.counts.malformed += 1
            self.counts.last_fault = f"a pose or twist that cannot be used: {odometry.position}, {odometry.orientation}"
            return None
        if last is not None:
            self.counts.skipped += attachment.sequence - last.sequence - 1
        self._source, self._last, self._is_sealed = attachment.gid, attachment, is_sealed(payload)
        self.counts.accepted += 1
        return Received(odometry, attachment, self._outside.monotonic_ns())

    def forget_source(self) -> None:
        """Listen to whoever publishes next."""
        self._source = self._last = None
        self._is_sealed = False

    def close(self) -> None:
        for token in (*self._tokens, *([self._obedience] if self._obedience is not None else [])):
            with contextlib.suppress(zenoh.ZError):
                token.undeclare()
        watched = [] if self._obeyed_tokens is None else [self._obeyed_tokens]
        for declared in (self._publisher, self._subscriber, *watched):
            with contextlib.suppress(zenoh.ZError):
                declared.undeclare()
