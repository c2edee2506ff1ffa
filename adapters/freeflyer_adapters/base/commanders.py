"""Announcement of the commanders of a base robot, one liveliness token each.

Zenoh's access control drops denied messages without an error at the sender. These tokens let a
controller detect a missing permission before it sends set points. The access control of the base
robot enforces the permission. Only links with certificates have these tokens.
"""

from __future__ import annotations

from typing import Any

from freeflyer_adapters.base import rmw_zenoh
from freeflyer_adapters.base.options import LinkOptions


def announce(session: Any, options: LinkOptions) -> list[Any]:
    """Declare the tokens, which the session keeps alive; none on a link without certificates."""
    if options.certificates is None:
        return []
    keys = [
        rmw_zenoh.commander_token(options.domain, options.setpoint_topic, name)
        for name in options.commanders
    ]
    return [session.liveliness().declare_token(key) for key in keys]


def announced(session: Any, options: LinkOptions) -> list[str]:
    """Return the certificate names that may command; empty if the base robot does not report."""
    key = rmw_zenoh.commander_token(options.domain, options.setpoint_topic, "*")
    replies = session.liveliness().get(key, timeout=1.0)
    return sorted(
        str(reply.ok.key_expr).rsplit("/", 1)[1] for reply in replies if reply.ok is not None
    )


def refusal(session: Any, options: LinkOptions, subject: str) -> str | None:
    """Return why set points of this session would be dropped, or None if this is not known."""
    if options.certificates is None:
        return None
    allowed = announced(session, options)
    if not allowed or options.controller in allowed:
        return None
    return (
        f"{subject} does not let certificate {options.controller!r} command, only {', '.join(allowed)}: "
        f"set `controller` to one of these, or add this one to the base robot's `commanders`"
    )
