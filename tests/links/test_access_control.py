"""Permissions of each certificate on the base robot's link, with real TLS sessions on loopback."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from lab import Lab, Wiretap, free_port, session_without_checks, waited

from freeflyer_adapters.base import (
    access_control,
    certificates,
    commanders,
    rmw_zenoh,
    ros_messages,
    tls_handshake,
)
from freeflyer_adapters.base.access_control import Protection
from freeflyer_adapters.base.certificate_authority import HOSTS, CertificateAuthority
from freeflyer_adapters.base.certificates import Identity
from freeflyer_adapters.base.endpoint import Endpoint
from freeflyer_adapters.base.link import OdometryLink, Received, is_usable
from freeflyer_adapters.base.options import LinkOptions
from freeflyer_adapters.base.session import open_session
from freeflyer_adapters.foundation.errors import DeviceError

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
ENDS = {"controller": "controller", "robot": "base_robot"}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    return Lab(tmp_path_factory.mktemp("lab"))


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as made:
        yield made


def opened(stack: ExitStack, session: Any) -> Any:
    stack.callback(session.close)
    return session


def linked(stack: ExitStack, session: Any, options: LinkOptions, *, as_robot: bool) -> OdometryLink:
    topics = (options.setpoint_topic, options.measured_topic)
    link = OdometryLink(session, options, *(reversed(topics) if as_robot else topics))
    stack.callback(link.close)
    return link


class Robot:
    def __init__(
        self, stack: ExitStack, options: LinkOptions, protection: Protection | None = None
    ) -> None:
        protection = protection or access_control.robot_protection(options)
        self.session = opened(stack, open_session([], options.connect, "robot", protection))
        self.link = linked(stack, self.session, options, as_robot=True)
        self.tokens = commanders.announce(self.session, options)


def controller(stack: ExitStack, options: LinkOptions) -> OdometryLink:
    session = opened(
        stack,
        open_session(
            options.connect, options.listen, "arm", access_control.controller_protection(options)
        ),
    )
    return linked(stack, session, options, as_robot=False)


def unchecked_peer(stack: ExitStack, lab: Lab, options: LinkOptions, name: str) -> OdometryLink:
    """Connect a peer with a valid certificate and plain Zenoh, without this project's checks."""
    own = Identity(lab.good, name)
    session = opened(
        stack, session_without_checks(connect=options.connect[0], authority=own.authority, own=own)
    )
    assert waited(lambda: bool(session.info.peers_zid())), (
        f"{name} has a valid certificate, and no link"
    )
    return linked(stack, session, options, as_robot=False)


def send(link: OdometryLink) -> None:
    link.publish(np.zeros(3), UPRIGHT, np.zeros(6))


def usable(received: Received) -> bool:
    return is_usable(received.odometry)


def arrives(sender: OdometryLink, receiver: OdometryLink, timeout: float = 5.0) -> bool:
    """Send samples repeatedly. Return True if one is received within `timeout` [s]."""

    def one() -> bool:
        send(sender)
        time.sleep(0.005)
        return receiver.receive(usable) is not None

    return waited(one, timeout)


def key(options: LinkOptions, topic: str) -> str:
    return rmw_zenoh.topic_key(
        options.domain, topic, ros_messages.TYPE_NAME, ros_messages.TYPE_HASH
    )


# Permissions


@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_controller_and_base_robot_exchange_samples(
    lab: Lab, stack: ExitStack, protocol: str
) -> None:
    options = lab.options(lab.good, free_port(), protocol)
    robot, host = Robot(stack, options), controller(stack, options)
    assert arrives(robot.link, host)
    assert arrives(host, robot.link)
    assert waited(lambda: commanders.announced(host.session, options) == ["controller"])
    robot.link.report_obeyed(True)
    assert waited(lambda: host.obeyed_publisher() == host.gid)
    assert host.publishers(options.setpoint_topic) == []


@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_an_observer_receives_measurements_and_its_set_points_are_dropped(
    lab: Lab, stack: ExitStack, protocol: str
) -> None:
    options = lab.options(lab.good, free_port(), protocol)
    robot, host = Robot(stack, options), controller(stack, options)
    observer = unchecked_peer(stack, lab, options, "observer")
    assert arrives(robot.link, observer)
    assert arrives(host, robot.link)
    robot.link.reset_source()
    assert not arrives(observer, robot.link, 0.5)
    # Zenoh drops the set points before the checks of this project.
    assert robot.link.counts.other_sources == robot.link.counts.malformed == 0
    assert arrives(host, robot.link), "the link was open all the time"


def test_without_access_control_the_same_observer_can_command_announce_and_delete(
    lab: Lab, stack: ExitStack
) -> None:
    """Counter-check of the other tests: with TLS only, the denied messages are received."""
    options = lab.options(lab.good, free_port())
    protection = access_control.robot_protection(options)
    assert protection is not None
    robot = Robot(stack, options, replace(protection, access={"enabled": False}))
    observer = unchecked_peer(stack, lab, options, "observer")
    assert arrives(observer, robot.link)
    forged = rmw_zenoh.commander_token(options.domain, options.setpoint_topic, "observer")
    token = observer.session.liveliness().declare_token(forged)
    assert waited(lambda: "observer" in commanders.announced(robot.session, options))
    observer.session.delete(key(options, options.setpoint_topic))
    assert waited(lambda: (robot.link.receive(usable), robot.link.counts.malformed == 1)[1])
    assert token


def test_a_valid_certificate_without_the_right_to_command_permits_only_reading(
    lab: Lab, stack: ExitStack
) -> None:
    options = lab.options(lab.good, free_port())
    robot = Robot(stack, options)
    other = unchecked_peer(stack, lab, options, "other_robot")
    assert arrives(robot.link, other)
    assert not arrives(other, robot.link, 0.5)


def test_a_second_commander_in_the_options_can_command(lab: Lab, stack: ExitStack) -> None:
    options = lab.options(lab.good, free_port(), commanders=("controller", "observer"))
    robot = Robot(stack, options)
    assert arrives(unchecked_peer(stack, lab, options, "observer"), robot.link)


def test_an_observer_cannot_forge_tokens(lab: Lab, stack: ExitStack) -> None:
    """No controller receives the forged tokens. The observer may read the tokens of the robot."""
    options = lab.options(lab.good, free_port())
    robot, host = Robot(stack, options), controller(stack, options)
    observer = unchecked_peer(stack, lab, options, "observer").session
    forged = rmw_zenoh.obedience_token(options.domain, options.setpoint_topic, "ff" * 16)
    also = rmw_zenoh.commander_token(options.domain, options.setpoint_topic, "observer")
    tokens = [observer.liveliness().declare_token(text) for text in (forged, also)]
    assert arrives(robot.link, host)
    robot.link.report_obeyed(True)
    assert waited(lambda: host.obeyed_publisher() == rmw_zenoh.NO_PUBLISHER)
    assert commanders.announced(host.session, options) == ["controller"]
    assert commanders.announced(robot.session, options) == ["controller"]
    assert commanders.announced(observer, options)
    assert host.publishers(options.setpoint_topic) == []
    assert tokens


def test_an_observer_cannot_receive_set_points_or_query_or_delete(
    lab: Lab, stack: ExitStack
) -> None:
    options = lab.options(lab.good, free_port())
    robot, host = Robot(stack, options), controller(stack, options)
    link = unchecked_peer(stack, lab, options, "observer")
    received: list[str] = []
    spy = link.session.declare_subscriber(
        "**", lambda sample: received.append(str(sample.key_expr))
    )
    queries: list[str] = []
    answering = robot.session.declare_queryable(
        key(options, options.measured_topic), lambda query: queries.append("query")
    )
    assert arrives(robot.link, link)
    assert arrives(host, robot.link)
    assert list(link.session.get(key(options, options.measured_topic), timeout=0.5)) == []
    assert received == [] or set(received) == {key(options, options.measured_topic)}
    link.session.delete(key(options, options.setpoint_topic))
    time.sleep(0.2)
    robot.link.receive(usable)
    assert robot.link.counts.malformed == 0
    assert queries == []
    spy.undeclare()
    answering.undeclare()


def test_an_observer_with_the_session_id_of_the_controller_is_rejected(
    lab: Lab, stack: ExitStack
) -> None:
    """A session id is public and does not authenticate a peer."""
    options = lab.options(lab.good, free_port())
    robot, host = Robot(stack, options), controller(stack, options)
    assert arrives(host, robot.link)
    own = Identity(lab.good, "observer")
    thief = session_without_checks(
        connect=options.connect[0], authority=own.authority, own=own, zid=str(host.session.zid())
    )
    link = linked(stack, opened(stack, thief), options, as_robot=False)
    robot.link.reset_source()
    assert not arrives(link, robot.link, 0.5)
    assert arrives(host, robot.link)


@pytest.mark.parametrize("protected", [False, True])
def test_traffic_is_only_readable_without_certificates(
    lab: Lab, stack: ExitStack, protected: bool
) -> None:
    options = lab.options(lab.good if protected else None, free_port())
    robot = Robot(stack, options)
    tap = Wiretap(Endpoint(options.connect[0]).port)
    stack.callback(tap.close)
    host = controller(stack, lab.options(options.certificates, tap.port))
    assert arrives(robot.link, host)
    assert arrives(host, robot.link)
    assert len(tap.bytes) > 1000
    assert (b"inertial" in tap.bytes) is not protected, "every message contains the frame name"


def test_the_controller_rejects_a_robot_with_a_certificate_of_another_name(
    lab: Lab, stack: ExitStack
) -> None:
    """Certificate and address are valid; only the name differs."""
    options = lab.options(lab.good, free_port())
    own = Identity(lab.good, "other_robot")
    session = opened(
        stack, session_without_checks(listen=options.connect[0], authority=own.authority, own=own)
    )
    robot, host = linked(stack, session, options, as_robot=True), controller(stack, options)
    assert waited(lambda: bool(host.session.info.peers_zid()))
    assert not arrives(robot, host, 0.5)
    assert not arrives(host, robot, 0.5), "set points go to the base robot only"
    found = tls_handshake.problem(
        Endpoint(options.connect[0]), Identity(lab.good, "controller"), "base_robot"
    )
    assert found is not None
    assert "belongs to 'other_robot', but 'base_robot' is expected there" in found


def test_the_port_of_the_controller_accepts_no_measurements_from_other_peers(
    lab: Lab, stack: ExitStack
) -> None:
    port = free_port()
    options = LinkOptions(
        connect=(f"tls/127.0.0.1:{free_port()}",),
        listen=(f"tls/127.0.0.1:{port}",),
        certificates=lab.good,
    )
    robot, host = Robot(stack, options), controller(stack, options)
    own = Identity(lab.good, "observer")
    session = opened(
        stack,
        session_without_checks(connect=f"tls/127.0.0.1:{port}", authority=own.authority, own=own),
    )
    assert waited(lambda: bool(session.info.peers_zid()))
    forger = linked(stack, session, options, as_robot=True)
    assert not arrives(forger, host, 0.5)
    assert arrives(robot.link, host)


# Rejected links and their diagnosis


def refused(stack: ExitStack, options: LinkOptions, **settings: Any) -> None:
    """Check that no transport is opened on either end."""
    robot = Robot(stack, options)
    session = opened(stack, session_without_checks(connect=options.connect[0], **settings))
    time.sleep(0.5)
    assert not session.info.peers_zid()
    assert not robot.session.info.peers_zid()


def why(options: LinkOptions, identity: Identity | None) -> str:
    found = tls_handshake.problem(Endpoint(options.connect[0]), identity, "base_robot")
    assert found is not None
    return found


def test_peers_without_a_valid_certificate_are_rejected_over_quic(
    lab: Lab, stack: ExitStack
) -> None:
    options = lab.options(lab.good, free_port(), "quic")
    robot = Robot(stack, options)
    for folder, name in (
        (lab.good, None),
        (lab.forged, "controller"),
        (lab.expired, "controller"),
    ):
        own = Identity(folder, name) if name else None
        session = opened(
            stack,
            session_without_checks(
                connect=options.connect[0], authority=folder / "ca.pem", own=own
            ),
        )
        time.sleep(0.3)
        assert not session.info.peers_zid()
    assert not robot.session.info.peers_zid()


def test_a_peer_without_certificate_is_rejected_with_the_reason(lab: Lab, stack: ExitStack) -> None:
    options = lab.options(lab.good, free_port())
    refused(stack, options, authority=lab.good / "ca.pem")
    assert "rejects our certificate: it requires a certificate, but no certificate was sent" in why(
        options, None
    )


def test_a_plain_tcp_connection_is_rejected_by_the_base(lab: Lab, stack: ExitStack) -> None:
    options = lab.options(lab.good, free_port())
    robot = Robot(stack, options)
    session = opened(
        stack, session_without_checks(connect=options.connect[0].replace("tls/", "tcp/"))
    )
    time.sleep(0.5)
    assert not session.info.peers_zid()
    assert not robot.session.info.peers_zid()


def test_a_controller_of_another_authority_is_rejected_with_the_reason(
    lab: Lab, stack: ExitStack
) -> None:
    options = lab.options(lab.good, free_port())
    own = Identity(lab.forged, "controller")
    refused(stack, options, authority=own.authority, own=own)
    found = why(options, own)
    assert "rejects our certificate: " in found
    assert "authority" in found
    assert "TLS alert" in found


def test_a_certificate_signed_by_an_observer_is_rejected_by_the_base(
    lab: Lab, stack: ExitStack, tmp_path: Path
) -> None:
    """The chain leads to the authority, but through a certificate without the right to sign."""
    key = load_pem_private_key((lab.good / "observer.key").read_bytes(), None)
    assert isinstance(key, EllipticCurvePrivateKey)
    observer = CertificateAuthority(
        key, x509.load_pem_x509_certificate((lab.good / "observer.pem").read_bytes())
    )
    own = Identity(tmp_path, "controller")
    observer.issue(own, days=1, hosts=HOSTS, may_listen=True)
    own.certificate.write_bytes(
        own.certificate.read_bytes() + (lab.good / "observer.pem").read_bytes()
    )
    own.authority.write_bytes((lab.good / "ca.pem").read_bytes())
    options = lab.options(lab.good, free_port())
    refused(stack, options, authority=own.authority, own=own)
    with pytest.raises(DeviceError, match="was not signed by the authority"):
        certificates.check(own, "base")


def test_an_expired_controller_is_rejected_by_the_base_with_the_reason(
    lab: Lab, stack: ExitStack
) -> None:
    options = lab.options(lab.good, free_port())
    own = Identity(lab.expired, "controller")
    refused(stack, options, authority=own.authority, own=own)
    assert (
        "rejects our certificate: our certificate has expired according to the clock of the peer (TLS alert: "
        in why(options, own)
    )


def robot_without_checks(stack: ExitStack, options: LinkOptions, own: Identity) -> None:
    opened(
        stack, session_without_checks(listen=options.connect[0], authority=own.authority, own=own)
    )


def test_a_base_of_another_authority_is_rejected_by_the_controller(
    lab: Lab, stack: ExitStack
) -> None:
    options = lab.options(lab.good, free_port())
    robot_without_checks(stack, options, Identity(lab.rogue, "base_robot"))
    host = controller(stack, options)
    assert not waited(lambda: bool(host.session.info.peers_zid()), 0.5)
    found = why(options, Identity(lab.good, "controller"))
    assert "'base_robot', was signed by another authority than ours" in found


def test_an_expired_base_is_rejected_by_the_controller(lab: Lab, stack: ExitStack) -> None:
    options = lab.options(lab.good, free_port())
    robot_without_checks(stack, options, Identity(lab.expired, "base_robot"))
    host = controller(stack, options)
    assert not waited(lambda: bool(host.session.info.peers_zid()), 0.5)
    assert "'base_robot', has expired on 20" in why(options, Identity(lab.good, "controller"))


def test_a_base_at_another_address_than_in_its_certificate_is_rejected(
    lab: Lab, stack: ExitStack, tmp_path: Path
) -> None:
    elsewhere = Identity(tmp_path, "base_robot")
    lab.authority.issue(elsewhere, days=1, hosts=["192.0.2.10"], may_listen=True)
    (tmp_path / "ca.pem").write_bytes((lab.good / "ca.pem").read_bytes())
    options = lab.options(lab.good, free_port())
    robot_without_checks(stack, options, elsewhere)
    host = controller(stack, options)
    assert not waited(lambda: bool(host.session.info.peers_zid()), 0.5)
    assert "'base_robot', is for 192.0.2.10, not for 127.0.0.1" in why(
        options, Identity(lab.good, "controller")
    )


def test_a_base_without_tls_is_reported(lab: Lab, stack: ExitStack) -> None:
    port = free_port()
    opened(stack, session_without_checks(listen=f"tcp/127.0.0.1:{port}"))
    assert "does not use TLS" in why(lab.options(lab.good, port), Identity(lab.good, "controller"))


def test_an_endpoint_without_listener_is_reported(lab: Lab) -> None:
    assert "nothing listens on tls/127.0.0.1:" in why(
        lab.options(lab.good, free_port()), Identity(lab.good, "controller")
    )


def test_a_link_ends_when_a_certificate_expires(lab: Lab, stack: ExitStack, tmp_path: Path) -> None:
    for name in ENDS.values():
        lab.authority.issue(
            Identity(tmp_path, name), days=4.0 / 86400, hosts=HOSTS, may_listen=True
        )
    (tmp_path / "ca.pem").write_bytes((lab.good / "ca.pem").read_bytes())
    options = lab.options(tmp_path, free_port())
    robot, host = Robot(stack, options), controller(stack, options)
    assert arrives(robot.link, host, 3.0)
    assert waited(lambda: not host.session.info.peers_zid(), 8.0)
    assert not arrives(robot.link, host, 0.3)
