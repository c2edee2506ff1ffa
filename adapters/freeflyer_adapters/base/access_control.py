"""Who may do what on the base robot's link, as Zenoh's access control enforces it, by the common name of the peer's certificate.

Zenoh judges every message that comes from a transport (ingress) or goes to one (egress) by its kind and its key expression: a rule holds
for a key that its own key expression includes, what several subjects are allowed adds up, and the rest is denied. Replies to
a liveliness query are declarations of tokens; a key that begins with @ is included by no ** that does not name it.
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
    """Who one end of a link is, and what it lets others do."""

    identity: Identity
    access: Rules
    """Zenoh's `access_control`."""
    listens_for_others: bool
    """Whether it is the end that others connect to."""


def controllers_end(options: LinkOptions) -> Protection | None:
    """Of the session that commands: it talks to the base robot, and to nobody else. None for a link without certificates."""
    if options.certificates is None:
        return None
    setpoint, measured, announced, own = _keys(options)
    robot = [
        _rule("robot may", "ingress", ["put"], [measured]),
        _rule("robot may", "ingress", ["declare_subscriber"], [setpoint]),
        _rule("robot may", "ingress", ["liveliness_token"], [announced, *own]),
        _rule("robot may", "ingress", QUERIES, [announced]),
        _rule("robot is told", "egress", ["put"], [setpoint]),
        _rule("robot is told", "egress", ["declare_subscriber"], [measured]),
        _rule("robot is told", "egress", ["liveliness_token"], [announced]),
        _rule("robot is told", "egress", QUERIES, [announced, *own]),
    ]
    access = _access({"robot": ({"cert_common_names": [options.robot]}, robot)})
    return Protection(
        identity=Identity(options.certificates, options.controller),
        access=access,
        listens_for_others=False,
    )


def robots_end(options: LinkOptions) -> Protection | None:
    """Of the base robot's session: commanders may send set points, everybody with a certificate may read what is measured."""
    if options.certificates is None:
        return None
    setpoint, measured, announced, own = _keys(options)
    reader = [
        _rule("reader may", "ingress", ["declare_subscriber"], [measured]),
        _rule("reader may", "ingress", QUERIES, [announced, *own]),
        _rule("reader is told", "egress", ["put"], [measured]),
        _rule("reader is told", "egress", ["liveliness_token"], [announced, *own]),
    ]
    commander = [
        _rule("commander may", "ingress", ["put"], [setpoint]),
        _rule("commander may", "ingress", ["liveliness_token"], [announced]),
        _rule("commander is told", "egress", ["declare_subscriber"], [setpoint]),
        _rule("commander is told", "egress", QUERIES, [announced]),
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
    """Set points, measurements, the announcements of rmw_zenoh, and this project's own tokens."""
    topics = [
        rmw_zenoh.topic_key(options.domain, topic, ros_messages.TYPE_NAME, ros_messages.TYPE_HASH)
        for topic in (options.setpoint_topic, options.measured_topic)
    ]
    own = [
        token(options.domain, options.setpoint_topic, "*")
        for token in (rmw_zenoh.obedience_token, rmw_zenoh.commander_token)
    ]
    return topics[0], topics[1], f"@ros2_lv/{options.domain}/**", own


def _rule(who: str, flow: str, messages: Sequence[str], keys: Sequence[str]) -> dict[str, Any]:
    name = f"{who} {', '.join(messages)}"
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
        "subjects": [{"id": name, **of} for name, (of, _) in subjects.items()],
        "policies": [
            {"subjects": [name], "rules": [rule["id"] for rule in rules]}
            for name, (_, rules) in subjects.items()
        ],
    }
