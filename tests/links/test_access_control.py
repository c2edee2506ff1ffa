"""What each holder of a certificate can do on the base robot's link: real sessions, real TLS, on loopback."""

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
from freeflyer_adapters.device.device import DeviceError

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
        protection = protection or access_control.robots_end(options)
        self.session = opened(stack, open_session([], options.connect, "robot", protection))
        self.link = linked(stack, self.session, options, as_robot=True)
        self.tokens = commanders.announce(self.session, options)


def controller(stack: ExitStack, options: LinkOptions) -> OdometryLink:
    session = opened(
        stack,
        open_session(
            options.connect, options.listen, "arm", access_control.controllers_end(options)
        ),
    )
    return linked(stack, session, options, as_robot=False)


def stranger(stack: ExitStack, lab: Lab, options: LinkOptions, name: str) -> OdometryLink:
    """Somebody with a valid certificate, and Zenoh as it comes: nothing of ours holds them back."""
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
    """Whether one of the samples that are sent again and again comes."""

    def one() -> bool:
        send(sender)
        time.sleep(0.005)
        return receiver.receive(usable) is not None

    return waited(one, timeout)


def key(options: LinkOptions, topic: str) -> str:
    return rmw_zenoh.topic_key(
        options.domain, topic, ros_messages.TYPE_NAME, ros_messages.TYPE_HASH
    )


# Who may do what


@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_controller_and_base_robot_talk_to_each_other(
    lab: Lab, stack: ExitStack, protocol: str
) -> None:
    options = lab.options(lab.good, free_port(), protocol)
    robot, host = Robot(stack, options), controller(stack, options)
    assert arrives(robot.link, host)
    assert arrives(host, robot.link)
    assert waited(lambda: commanders.announced(host.session, options) == ["controller"])
    robot.link.tell_obeyed(True)
    assert waited(lambda: host.obeyed() == host.gid)
    assert host.publishers(options.setpoint_topic) == []


@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_an_observer_reads_and_its_set_points_come_to_nobody(
    lab: Lab, stack: ExitStack, protocol: str
) -> None:
    options = lab.options(lab.good, free_port(), protocol)
    robot, host = Robot(stack, options), controller(stack, options)
    observer = stranger(stack, lab, options, "observer")
    assert arrives(robot.link, observer)
    assert arrives(host, robot.link)
    robot.link.forget_source()
    assert not arrives(observer, robot.link, 0.5)
    assert (
        robot.link.counts.other_sources == robot.link.counts.malformed == 0
    )  # they were stopped before this project's own checks
    assert arrives(host, robot.link), "the link itself was there all the time"


def test_without_access_control_the_same_observer_would_command_announce_and_delete(
    lab: Lab, stack: ExitStack
) -> None:
    """What the other tests find denied does arrive where only TLS stands before it: so they can fail."""
    options = lab.options(lab.good, free_port())
    protection = access_control.robots_end(options)
    assert protection is not None
    robot = Robot(stack, options, replace(protection, access={"enabled": False}))
    observer = stranger(stack, lab, options, "observer")
    assert arrives(observer, robot.link)
    forged = rmw_zenoh.commander_token(options.domain, options.setpoint_topic, "observer")
    token = observer.session.liveliness().declare_token(forged)
    assert waited(lambda: "observer" in commanders.announced(robot.session, options))
    observer.session.delete(key(options, options.setpoint_topic))
    assert waited(lambda: (robot.link.receive(usable), robot.link.counts.malformed == 1)[1])
    assert token


def test_every_valid_certificate_that_is_no_commanders_is_an_observers(
    lab: Lab, stack: ExitStack
) -> None:
    options = lab.options(lab.good, free_port())
    robot = Robot(stack, options)
    other = stranger(stack, lab, options, "other_robot")
    assert arrives(robot.link, other)
    assert not arrives(other, robot.link, 0.5)


def test_a_second_commander_commands_where_it_is_named(lab: Lab, stack: ExitStack) -> None:
    options = lab.options(lab.good, free_port(), commanders=("controller", "observer"))
    robot = Robot(stack, options)
    assert arrives(stranger(stack, lab, options, "observer"), robot.link)


def test_an_observer_cannot_announce_what_it_has_no_right_to(lab: Lab, stack: ExitStack) -> None:
    """Its tokens (another commander, another who is obeyed) come to no controller; what the robot tells, it may hear."""
    options = lab.options(lab.good, free_port())
    robot, host = Robot(stack, options), controller(stack, options)
    observer = stranger(stack, lab, options, "observer").session
    forged = rmw_zenoh.obedience_token(options.domain, options.setpoint_topic, "ff" * 16)
    also = rmw_zenoh.commander_token(options.domain, options.setpoint_topic, "observer")
    tokens = [observer.liveliness().declare_token(text) for text in (forged, also)]
    assert arrives(robot.link, host)
    robot.link.tell_obeyed(True)
    assert waited(lambda: host.obeyed() == rmw_zenoh.NOBODY)
    assert commanders.announced(host.session, options) == ["controller"]
    assert commanders.announced(robot.session, options) == ["controller"]
    assert commanders.announced(observer, options)
    assert host.publishers(options.setpoint_topic) == []
    assert tokens


def test_an_observer_neither_hears_set_points_nor_queries_nor_deletes(
    lab: Lab, stack: ExitStack
) -> None:
    options = lab.options(lab.good, free_port())
    robot, host = Robot(stack, options), controller(stack, options)
    link = stranger(stack, lab, options, "observer")
    heard: list[str] = []
    spy = link.session.declare_subscriber("**", lambda sample: heard.append(str(sample.key_expr)))
    asked: list[str] = []
    answering = robot.session.declare_queryable(
        key(options, options.measured_topic), lambda query: asked.append("query")
    )
    assert arrives(robot.link, link)
    assert arrives(host, robot.link)
    assert list(link.session.get(key(options, options.measured_topic), timeout=0.5)) == []
    assert heard == [] or set(heard) == {key(options, options.measured_topic)}
    link.session.delete(key(options, options.setpoint_topic))
    time.sleep(0.2)
    robot.link.receive(usable)
    assert robot.link.counts.malformed == 0
    assert asked == []
    spy.undeclare()
    answering.undeclare()


def test_an_observer_under_the_controllers_own_session_id_gets_no_link(
    lab: Lab, stack: ExitStack
) -> None:
    """A session's id is no secret and no proof."""
    options = lab.options(lab.good, free_port())
    robot, host = Robot(stack, options), controller(stack, options)
    assert arrives(host, robot.link)
    own = Identity(lab.good, "observer")
    thief = session_without_checks(
        connect=options.connect[0], authority=own.authority, own=own, zid=str(host.session.zid())
    )
    link = linked(stack, opened(stack, thief), options, as_robot=False)
    robot.link.forget_source()
    assert not arrives(link, robot.link, 0.5)
    assert arrives(host, robot.link)


@pytest.mark.parametrize("protected", [False, True])
def test_what_goes_over_the_wire_can_be_read_without_certificates_only(
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
    assert (b"inertial" in tap.bytes) is not protected, (
        "the frame's name, which is in every message"
    )


def test_a_robot_of_another_name_is_not_believed_by_the_controller(
    lab: Lab, stack: ExitStack
) -> None:
    """Its certificate is valid and its address is right: only the name tells."""
    options = lab.options(lab.good, free_port())
    own = Identity(lab.good, "other_robot")
    session = opened(
        stack, session_without_checks(listen=options.connect[0], authority=own.authority, own=own)
    )
    robot, host = linked(stack, session, options, as_robot=True), controller(stack, options)
    assert waited(lambda: bool(host.session.info.peers_zid()))
    assert not arrives(robot, host, 0.5)
    assert not arrives(host, robot, 0.5), "set points go to the base robot only"
    found = tls_handshake.trouble(
        Endpoint(options.connect[0]), Identity(lab.good, "controller"), "base_robot"
    )
    assert found is not None
    assert "is that of 'other_robot', but 'base_robot' is expected there" in found


def test_the_controllers_own_port_lets_nobody_put_a_measurement(lab: Lab, stack: ExitStack) -> None:
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


# Who gets no link at all, and what is said of it


def refused(stack: ExitStack, options: LinkOptions, **of: Any) -> None:
    """No transport comes about, seen from both ends."""
    robot = Robot(stack, options)
    session = opened(stack, session_without_checks(connect=options.connect[0], **of))
    time.sleep(0.5)
    assert not session.info.peers_zid()
    assert not robot.session.info.peers_zid()


def why(options: LinkOptions, who: Identity | None) -> str:
    found = tls_handshake.trouble(Endpoint(options.connect[0]), who, "base_robot")
    assert found is not None
    return found


def test_nobody_whose_certificate_cannot_be_checked_comes_in_over_quic_either(
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


def test_without_a_certificate_the_base_is_not_reached_and_says_so(
    lab: Lab, stack: ExitStack
) -> None:
    options = lab.options(lab.good, free_port())
    refused(stack, options, authority=lab.good / "ca.pem")
    assert "refuses our certificate: it demands a certificate, and was given none" in why(
        options, None
    )


def test_plain_tcp_does_not_reach_the_base(lab: Lab, stack: ExitStack) -> None:
    options = lab.options(lab.good, free_port())
    robot = Robot(stack, options)
    session = opened(
        stack, session_without_checks(connect=options.connect[0].replace("tls/", "tcp/"))
    )
    time.sleep(0.5)
    assert not session.info.peers_zid()
    assert not robot.session.info.peers_zid()


def test_another_authoritys_controller_is_refused_by_the_base_and_told_why(
    lab: Lab, stack: ExitStack
) -> None:
    options = lab.options(lab.good, free_port())
    own = Identity(lab.forged, "controller")
    refused(stack, options, authority=own.authority, own=own)
    found = why(options, own)
    assert "refuses our certificate: " in found
    assert "authority" in found
    assert "TLS alert" in found


def test_a_certificate_that_an_observer_has_signed_is_refused_by_the_base(
    lab: Lab, stack: ExitStack, tmp_path: Path
) -> None:
    """Its chain leads to the right authority, but by way of a certificate that may not sign."""
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


def test_an_expired_controller_is_refused_by_the_base_and_told_why(
    lab: Lab, stack: ExitStack
) -> None:
    options = lab.options(lab.good, free_port())
    own = Identity(lab.expired, "controller")
    refused(stack, options, authority=own.authority, own=own)
    assert "refuses our certificate: ours has expired, by its clock (TLS alert: " in why(
        options, own
    )


def robot_without_checks(stack: ExitStack, options: LinkOptions, own: Identity) -> None:
    opened(
        stack, session_without_checks(listen=options.connect[0], authority=own.authority, own=own)
    )


def test_a_base_of_another_authority_is_refused_by_the_controller(
    lab: Lab, stack: ExitStack
) -> None:
    options = lab.options(lab.good, free_port())
    robot_without_checks(stack, options, Identity(lab.rogue, "base_robot"))
    host = controller(stack, options)
    assert not waited(lambda: bool(host.session.info.peers_zid()), 0.5)
    found = why(options, Identity(lab.good, "controller"))
    assert "'base_robot', was signed by another authority than ours" in found


def test_an_expired_base_is_refused_by_the_controller(lab: Lab, stack: ExitStack) -> None:
    options = lab.options(lab.good, free_port())
    robot_without_checks(stack, options, Identity(lab.expired, "base_robot"))
    host = controller(stack, options)
    assert not waited(lambda: bool(host.session.info.peers_zid()), 0.5)
    assert "'base_robot', has expired on 20" in why(options, Identity(lab.good, "controller"))


def test_a_base_under_another_address_than_its_certificates_is_refused(
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


def test_a_base_without_tls_is_said_to_be_one(lab: Lab, stack: ExitStack) -> None:
    port = free_port()
    opened(stack, session_without_checks(listen=f"tcp/127.0.0.1:{port}"))
    assert "does not speak TLS" in why(
        lab.options(lab.good, port), Identity(lab.good, "controller")
    )


def test_nobody_there_is_said(lab: Lab) -> None:
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
