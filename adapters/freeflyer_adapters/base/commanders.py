"""Announcement of the commanders of a base robot by liveliness tokens.

A commander is a controller whose certificate may send set points. The base robot declares one token
for each commander.

Zenoh's access control drops denied messages, and the sender receives no error. With these tokens, a
controller detects a missing permission before the controller sends set points. The tokens only
inform; the access control of the base robot enforces the permission. Only links with certificates
have these tokens.
"""

from __future__ import annotations

from typing import Any

from freeflyer_adapters.base import rmw_zenoh
from freeflyer_adapters.base.options import LinkOptions


def announce(session: Any, options: LinkOptions) -> list[Any]:
    """Declare the tokens and return them. The session keeps the tokens alive.

    On a link without certificates, no token is declared.
    """
    if options.certificates is None:
        return []
    keys = [
        rmw_zenoh.commander_token(options.domain, options.setpoint_topic, name)
        for name in options.commanders
    ]
    return [session.liveliness().declare_token(key) for key in keys]


def announced(session: Any, options: LinkOptions) -> list[str]:
    """Return the names of the certificates that may command.

    The list is empty if the base robot does not report these names.
    """
    key = rmw_zenoh.commander_token(options.domain, options.setpoint_topic, "*")
    replies = session.liveliness().get(key, timeout=1.0)
    return sorted(
        str(reply.ok.key_expr).rsplit("/", 1)[1] for reply in replies if reply.ok is not None
    )


def refusal(session: Any, options: LinkOptions, subject: str) -> str | None:
    """Return the reason why set points of this session would be dropped.

    Returns None if no reason is known.
    """
    if options.certificates is None:
        return None
    allowed = announced(session, options)
    if not allowed or options.controller in allowed:
        return None
    return (
        f"{subject} does not let certificate {options.controller!r} command, only {', '.join(allowed)}: "
        f"set `controller` to one of the accepted names, or add {options.controller!r} to the base robot's `commanders`"
    )
