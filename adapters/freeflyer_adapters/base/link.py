"""Odometry over a Zenoh session: one topic is published, another topic is read.

Some terms of this module:
- GID: the global identifier of a publisher in ROS.
- source: the publisher whose samples are used.
- publisher in command: the publisher from which the base robot accepts set points.
- obedience token: the liveliness token by which a base robot reports the publisher in command.
- announcement: the liveliness token by which rmw_zenoh announces a publisher.
"""

from __future__ import annotations

import contextlib
import itertools
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zenoh

from freeflyer.fmi.component import Array
from freeflyer_adapters.base import rmw_zenoh, ros_messages
from freeflyer_adapters.base.options import LinkOptions
from freeflyer_adapters.base.peer_clock import PeerClock
from freeflyer_adapters.base.rmw_zenoh import Attachment, AttachmentError
from freeflyer_adapters.base.ros_messages import MessageError, Odometry, OdometryWriter
from freeflyer_adapters.base.sealed_odometry import (
    checksum,
    is_intact,
    is_sealable,
    is_sealed,
    sealed,
)
from freeflyer_adapters.base.session import zenoh_message
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.foundation.pose import twist_rotated

LONGEST_QUERY = 0.5
"""Timeout of a query for liveliness tokens [s]."""
SECOND, WITHIN = 3, 20
"""A second publisher is reported if its samples are interleaved with the samples of the source.

Condition: samples of other publishers arrive `SECOND` times, while at most `WITHIN` samples of the
source are accepted. Several consecutive samples of other publishers are counted as one.
"""
LARGEST = 1e4
"""Limit of the absolute value of a position [m] or velocity [m/s, rad/s], for each component."""


def is_usable(odometry: Odometry) -> bool:
    """Return True if position and velocity are plausible and the orientation has unit norm."""
    # A comparison with NaN is False, so NaN is rejected.
    possible = (np.abs(odometry.position) < LARGEST).all() and (
        np.abs(odometry.velocity) < LARGEST
    ).all()
    return bool(possible) and 0.98 < float(odometry.orientation @ odometry.orientation) < 1.02


@dataclass
class Received:
    """The latest sample."""

    odometry: Odometry
    attachment: Attachment
    arrived: int
    """Time at which the sample was read [ns of CLOCK_MONOTONIC]."""
    delay: int = 0
    """Transport delay relative to the fastest sample so far [ns] (see `PeerClock`)."""


@dataclass
class Counts:
    accepted: int = 0
    skipped: int = 0
    """Number of missing samples, which were lost or were replaced by a later sample."""
    malformed: int = 0
    stale: int = 0
    """Samples that are repeated, reordered or older than the previous sample."""
    other_sources: int = 0
    """Samples of publishers that are not the source."""
    undecided: int = 0
    """Samples that are ignored, because it is not known yet whether they arrive in time."""
    clock_steps: int = 0
    """Steps of the source's clock."""
    failed: int = 0
    """Samples that Zenoh did not accept for sending."""
    last_fault: str = ""


@dataclass
class OdometryLink:
    """Publisher of Odometry on `out_topic`, and reader of the latest sample of `in_topic`.

    If `publishes` is False, there is no publisher before `begin_publishing` is called. Each new
    publisher has a new GID.
    """

    session: Any
    options: LinkOptions
    out_topic: str
    in_topic: str
    publishes: bool = True
    counts: Counts = field(default_factory=Counts)

    def __post_init__(self) -> None:
        o = self.options
        self._environment = environment.present()
        self._session_id = str(self.session.zid())
        # A time stamp is CLOCK_MONOTONIC plus the constant `_wall`. So a later step of the wall
        # clock does not affect the time stamps.
        self._wall = self._environment.time_ns() - self._environment.monotonic_ns()
        self._publisher: Any = None
        self._gid = b""
        self._entities = itertools.count(2)
        self._tokens: list[Any] = []
        self._writer = OdometryWriter(o.frame, o.child_frame)
        self._sequence = 0
        self._obedience: Any = None
        self._obeyed_tokens: Any = None
        self._announcements: list[Any] = []
        self.known: frozenset[str] = frozenset()
        """Sessions that are known to publish.

        `new_publisher` does not report these sessions, because after a link failure a session
        repeats its announcement.
        """
        self._reported = ""
        self.clock = PeerClock()
        self._source: bytes | None = None
        self._last: Attachment | None = None
        self._other_source = b""
        # Values of `counts.accepted` when samples of other publishers arrived.
        self._turns: deque[int] = deque(maxlen=SECOND)
        self._is_sealed = False
        """True if the source sends checksums. In this case, every sample must have a checksum."""
        try:
            self._subscriber = self.session.declare_subscriber(
                self._key(self.in_topic), zenoh.handlers.RingChannel(1)
            )
            self._tokens.append(
                self.session.liveliness().declare_token(self._token(self.in_topic, "MS", 1))
            )
            if self.publishes:
                self.begin_publishing()
        except zenoh.ZError as error:
            raise DeviceError(f"Zenoh rejects a topic: {zenoh_message(error)}") from error

    def begin_publishing(self) -> None:
        """Declare a publisher with a new GID.

        The GID was never used before. So the base robot has neither accepted nor rejected it yet.
        """
        token = self._token(self.out_topic, "MP", next(self._entities))
        self._gid, self._sequence = rmw_zenoh.gid_of(token), 0
        self._publisher = self.session.declare_publisher(
            self._key(self.out_topic),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )
        self._announcement = self.session.liveliness().declare_token(token)

    def end_publishing(self) -> None:
        """Undeclare the publisher. Its GID is not used again."""
        if self._publisher is not None:
            publisher, self._publisher = self._publisher, None
            for declared in (self._announcement, publisher):
                with contextlib.suppress(zenoh.ZError):
                    declared.undeclare()

    def _key(self, topic: str) -> str:
        return rmw_zenoh.topic_key(
            self.options.domain, topic, ros_messages.TYPE_NAME, ros_messages.TYPE_HASH
        )

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
        """GID of the own publisher (hexadecimal). All published samples contain this GID."""
        return self._gid.hex()

    @property
    def identity(self) -> str:
        return self._session_id

    def publishers(self, topic: str) -> list[str]:
        """Return the other sessions that announce a publisher of `topic`."""
        found = set()
        for reply in self.session.liveliness().get(
            self._announcements_of(topic), timeout=LONGEST_QUERY
        ):
            if reply.ok is not None:
                found.add(rmw_zenoh.session_of(str(reply.ok.key_expr)))
        return sorted(found - {self._session_id})

    def _announcements_of(self, topic: str) -> str:
        name = rmw_zenoh.mangled("/" + topic.strip("/"))
        return f"@ros2_lv/{self.options.domain}/*/*/*/MP/*/*/*/{name}/**"

    def watch_publishers(self) -> None:
        """Subscribe to the announcements of publishers of both topics, for `new_publisher`."""
        liveliness = self.session.liveliness()
        self._announcements = [
            (
                topic,
                liveliness.declare_subscriber(
                    self._announcements_of(topic), zenoh.handlers.FifoChannel(64)
                ),
            )
            for topic in (self.in_topic, self.out_topic)
        ]

    def new_publisher(self) -> str | None:
        """Return a message about a publisher that was announced since the last call, or None.

        Does not block.
        """
        for topic, subscriber in self._announcements:
            news = subscriber.try_recv()
            if news is not None and news.kind == zenoh.SampleKind.PUT:
                session = rmw_zenoh.session_of(str(news.key_expr))
                if session != self._session_id and session not in self.known:
                    return f"session {session} also starts to publish topic {topic}"
        return None

    @property
    def second_source(self) -> str | None:
        """Message if the samples of two publishers are interleaved (see `SECOND`), or None."""
        if len(self._turns) < SECOND or self.counts.accepted - self._turns[0] > WITHIN:
            return None
        assert self._source is not None
        return f"two publishers send topic {self.in_topic}: {self._source.hex()} and {self._other_source.hex()}"

    def publish(self, position: Array, orientation: Array, velocity: Array) -> None:
        """Publish the pose of the base B in the inertial frame I, and the twist of B.

        position (3) [m], orientation (4, xyzw) and velocity (6) [m/s, rad/s] are expressed in I.
        In the message, the twist is expressed in B.
        """
        stamp = self._environment.monotonic_ns() + self._wall
        self._sequence += 1
        twist = twist_rotated(orientation, velocity, back=True)
        # Not every checksum may be stored in a sample (see `is_sealable`). The checksum depends on
        # the stamp. Increment the stamp until the checksum may be stored.
        while True:
            attachment = Attachment(self._sequence, stamp, self._gid).pack()
            payload = self._writer.write(stamp, position, orientation, twist)
            if is_sealable(checksum(payload, attachment)):
                break
            stamp += 1
        self.put(sealed(payload, attachment), attachment)

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Send a sample. A failure is counted, not raised."""
        if self._publisher is None:
            return
        try:
            self._publisher.put(payload, attachment=attachment)
        except zenoh.ZError as error:
            self.counts.failed += 1
            self.counts.last_fault = zenoh_message(error)

    def take(self) -> tuple[bytes, bytes] | None:
        """Return the payload and the attachment of the latest sample.

        Returns None if there is no new sample. Does not block.
        """
        sample = self._subscriber.try_recv()
        if sample is None:
            return None
        return (
            sample.payload.to_bytes(),
            b"" if sample.attachment is None else sample.attachment.to_bytes(),
        )

    def obeyed_publisher(self) -> str | None:
        """Return the GID of the publisher in command, or NO_PUBLISHER.

        Returns None if the base robot does not report the publisher in command.
        """
        key = rmw_zenoh.obedience_token(self.options.domain, self.options.setpoint_topic, "*")
        found = [
            str(reply.ok.key_expr).rsplit("/", 1)[1]
            for reply in self.session.liveliness().get(key, timeout=LONGEST_QUERY)
            if reply.ok is not None
        ]
        # While the base robot changes its report, there may be two tokens. A GID has priority over
        # NO_PUBLISHER.
        return next(
            (gid for gid in found if gid != rmw_zenoh.NO_PUBLISHER), found[0] if found else None
        )

    def watch_obedience(self) -> None:
        """Subscribe to the obedience token for the own publisher. `obedience` reads the token."""
        key = rmw_zenoh.obedience_token(self.options.domain, self.options.setpoint_topic, self.gid)
        self._obeyed_tokens = self.session.liveliness().declare_subscriber(
            key, zenoh.handlers.FifoChannel(64)
        )

    def obedience(self) -> bool | None:
        """Return the change of the obedience token since the last call. Does not block.

        True: the own publisher is in command. False: the own publisher is no longer in command.
        None: no change.
        """
        news = None if self._obeyed_tokens is None else self._obeyed_tokens.try_recv()
        return None if news is None else news.kind == zenoh.SampleKind.PUT

    def report_obeyed(self, active: bool) -> None:
        """Update the obedience token. Only the base robot's end of the link calls this method.

        `active`: whether the base robot is in the state active. If `active` is True and there is a
        source, the token contains the GID of the source. Otherwise, the token contains
        NO_PUBLISHER.
        """
        gid = self._source.hex() if active and self._source is not None else rmw_zenoh.NO_PUBLISHER
        if gid != self._reported:
            before, self._reported = self._obedience, gid
            key = rmw_zenoh.obedience_token(self.options.domain, self.options.setpoint_topic, gid)
            self._obedience = self.session.liveliness().declare_token(key)
            if before is not None:
                before.undeclare()

    def receive(self, judge: Callable[[Received], bool | None]) -> Received | None:
        """Return the latest sample since the last call, or None if no valid sample has arrived.

        Does not block. `judge` returns True to accept a sample, False to reject the sample, and
        None to ignore the sample. The publisher of the first accepted sample becomes the source.
        After this, samples of other publishers are ignored.
        """
        sample = self.take()
        if sample is None:
            return None
        # Check the checksum, the format of the message and the frame names.
        payload, raw = sample
        if (is_sealed(payload) or self._is_sealed) and not is_intact(payload, raw):
            return self._refused("a sample with a wrong checksum")
        try:
            attachment = rmw_zenoh.read_attachment(raw)
            odometry = ros_messages.read(payload)
        except (AttachmentError, MessageError) as error:
            return self._refused(str(error))
        frames, expected = (
            (odometry.frame, odometry.child_frame),
            (self.options.frame, self.options.child_frame),
        )
        if frames != expected:
            return self._refused(
                f"a pose of {frames[1]!r} in {frames[0]!r} (child_frame_id, header.frame_id); {expected[1]!r} in {expected[0]!r} is "
                f"expected (the device's options child_frame, frame)"
            )
        # Check the publisher and the order of its samples.
        if self._source is not None and attachment.gid != self._source:
            self._note_other_source(attachment.gid)
            return None
        last, arrived = self._last, self._environment.monotonic_ns()
        if last is not None and (
            attachment.sequence <= last.sequence or attachment.stamp == last.stamp
        ):
            self.counts.stale += 1
            self.counts.last_fault = f"sequence number {attachment.sequence} after {last.sequence}; the time stamp has advanced by {(attachment.stamp - last.stamp) * 1e-9:.6g} s"
            return None
        # The caller's function `judge` checks the values.
        delay = self.clock.delay(attachment.stamp, arrived)
        received = Received(odometry, attachment, arrived, delay)
        judged = judge(received)
        if judged is None:
            self.counts.undecided += 1
            return None
        if not judged:
            if self._source is None:
                self.clock.reset()  # the next publisher may use a different clock
            return self._refused(
                f"an invalid pose or twist: {odometry.position}, {odometry.orientation}, {delay * 1e-9:.3g} s late"
            )
        if last is not None:
            self.counts.skipped += attachment.sequence - last.sequence - 1
        self._source, self._last, self._is_sealed = attachment.gid, attachment, is_sealed(payload)
        self.counts.accepted += 1
        self.counts.clock_steps = self.clock.steps
        return received

    def _refused(self, why: str) -> Received | None:
        self.counts.malformed += 1
        self.counts.last_fault = why
        return None

    @property
    def other_source(self) -> bytes:
        """GID of the last sample that did not come from the source. Initially empty."""
        return self._other_source

    def _note_other_source(self, gid: bytes) -> None:
        self.counts.other_sources += 1
        self.counts.last_fault = f"a sample from {gid.hex()}, but the source in use is {self._source.hex() if self._source else ''}"
        self._other_source = gid
        if not self._turns or self._turns[-1] != self.counts.accepted:
            self._turns.append(self.counts.accepted)

    def reset_counts(self) -> None:
        self.counts, self.clock.steps = Counts(), 0
        self._turns.clear()

    def reset_source(self) -> None:
        """Remove the source. The publisher of the next accepted sample becomes the source."""
        self._source = self._last = None
        self._other_source, self._is_sealed = b"", False
        self._turns.clear()
        self.clock.reset()

    def close(self) -> None:
        self.end_publishing()
        watched = [subscriber for _, subscriber in self._announcements]
        watched += [self._obeyed_tokens] if self._obeyed_tokens is not None else []
        tokens = [*self._tokens, *([self._obedience] if self._obedience is not None else [])]
        for declared in (*tokens, *watched, self._subscriber):
            with contextlib.suppress(zenoh.ZError):
                declared.undeclare()
