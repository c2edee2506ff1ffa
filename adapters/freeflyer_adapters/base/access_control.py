"""Zenoh access control of the base robot's link, by the common names of the certificates.

Zenoh checks every message that arrives from a peer (flow: ingress) and every message that is sent
to a peer (flow: egress). For this check, Zenoh compares the flow, the kind and the Zenoh key of the
message with the rules. A rule permits messages of certain kinds in one flow, if one of its key
expressions includes the key of the message. A subject is a group of peers, to which rules are
assigned. A peer belongs to a subject by the name of its certificate, or by the protocol of its
link. If a peer belongs to several subjects, it has the permissions of all of them. All messages
without a permission are denied.

In the names of the rules below, "PEER may" is the ingress from PEER, and "PEER receives" is the
egress to PEER. Two properties of Zenoh determine these rules. First, the reply to a liveliness
query counts as a declaration of a token. So the reply needs the permission `liveliness_token`.
Second, the wildcard ** does not match parts of a key that start with @. So the key expression for
the tokens of rmw_zenoh starts with @ros2_lv.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from freeflyer_adapters.base import rmw_zenoh, ros_messages
from freeflyer_adapters.base.certificates import Identity
from freeflyer_adapters.base.endpoint import ENCRYPTED
from freeflyer_adapters.base.options import LinkOptions

Rules = Mapping[str, Any]
QUERIES = ("liveliness_query", "declare_liveliness_subscriber")


@dataclass(frozen=True, kw_only=True)
class Protection:
    """Identity of one end of a link, and the permissions that this end gives to its peers."""

    identity: Identity
    access: Rules
    """The `access_control` section of the Zenoh configuration."""
    listens_for_others: bool
    """True for the base robot, because the other peers connect to it.

    If this value is True, the certificate must be valid for listening, and for the hosts in the
    listening endpoints.
    """


def controller_protection(options: LinkOptions) -> Protection | None:
    """Return the protection of the controller's session, or None without certificates.

    The session exchanges messages with the base robot only.
    """
    if options.certificates is None:
        return None
    setpoint, measured, announced, own = _keys(options)
    robot = [
        _rule("robot may", "ingress", ["put"], [measured]),
        _rule("robot may", "ingress", ["declare_subscriber"], [setpoint]),
        _rule("robot may", "ingress", ["liveliness_token"], [announced, *own]),
        _rule("robot may", "ingress", QUERIES, [announced]),
        _rule("robot receives", "egress", ["put"], [setpoint]),
        _rule("robot receives", "egress", ["declare_subscriber"], [measured]),
        _rule("robot receives", "egress", ["liveliness_token"], [announced]),
        _rule("robot receives", "egress", QUERIES, [announced, *own]),
    ]
    access = _access({"robot": ({"cert_common_names": [options.robot]}, robot)})
    return Protection(
        identity=Identity(options.certificates, options.controller),
        access=access,
        listens_for_others=False,
    )


def robot_protection(options: LinkOptions) -> Protection | None:
    """Return the protection of the base robot's session, or None without certificates.

    The peers named in `options.commanders` may send set points. Every peer with a certificate may
    read the measurements.
    """
    if options.certificates is None:
        return None
    setpoint, measured, announced, own = _keys(options)
    reader = [
        _rule("reader may", "ingress", ["declare_subscriber"], [measured]),
        _rule("reader may", "ingress", QUERIES, [announced, *own]),
        _rule("reader receives", "egress", ["put"], [measured]),
        _rule("reader receives", "egress", ["liveliness_token"], [announced, *own]),
    ]
    commander = [
        _rule("commander may", "ingress", ["put"], [setpoint]),
        _rule("commander may", "ingress", ["liveliness_token"], [announced]),
        _rule("commander receives", "egress", ["declare_subscriber"], [setpoint]),
        _rule("commander receives", "egress", QUERIES, [announced]),
    ]
    access = _access({
        "reader": ({"link_protocols": list(ENCRYPTED)}, reader),
        "commander": ({"cert_common_names": list(options.commanders)}, commander),
    })  # fmt: skip
    return Protection(
        identity=Identity(options.certificates, options.robot),
        access=access,
        listens_for_others=True,
    )


def _keys(options: LinkOptions) -> tuple[str, str, str, list[str]]:
    """Return the key expressions of set points, measurements, announcements and own tokens.

    Announcements are the liveliness tokens of rmw_zenoh. Own tokens are the liveliness tokens that
    only this project defines.
    """
    topics = [
        rmw_zenoh.topic_key(options.domain, topic, ros_messages.TYPE_NAME, ros_messages.TYPE_HASH)
        for topic in (options.setpoint_topic, options.measured_topic)
    ]
    own = [
        token(options.domain, options.setpoint_topic, "*")
        for token in (rmw_zenoh.obedience_token, rmw_zenoh.commander_token)
    ]
    return topics[0], topics[1], f"@ros2_lv/{options.domain}/**", own


def _rule(subject: str, flow: str, messages: Sequence[str], keys: Sequence[str]) -> dict[str, Any]:
    name = f"{subject} {', '.join(messages)}"
    return {
        "id": name,
        "permission": "allow",
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": list(keys),
    }


def _access(subjects: Mapping[str, tuple[Mapping[str, Any], list[dict[str, Any]]]]) -> Rules:
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for _, rules in subjects.values() for rule in rules],
        "subjects": [{"id": name, **match} for name, (match, _) in subjects.items()],
        "policies": [
            {"subjects": [name], "rules": [rule["id"] for rule in rules]}
            for name, (_, rules) in subjects.items()
        ],
    }
