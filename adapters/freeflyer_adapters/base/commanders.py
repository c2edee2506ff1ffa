"""Announcement of the commanders of a base robot by liveliness tokens.

A commander is a controller whose certificate has the permission to send set points. The base robot
declares one token for each commander.

Zenoh's access control drops messages without a permission, and the sender receives no error. By
these tokens, a controller checks its permission before it sends set points. The tokens only give
information; the access control of the base robot enforces the permission. Only links with
certificates have these tokens.
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
    """Return the certificate names of the controllers that may send set points.

    The names are read from the tokens of the base robot. Without tokens, the list is empty.
    """
    key = rmw_zenoh.commander_token(options.domain, options.setpoint_topic, "*")
    replies = session.liveliness().get(key, timeout=1.0)
    return sorted(
        str(reply.ok.key_expr).rsplit("/", 1)[1] for reply in replies if reply.ok is not None
    )


def refusal(session: Any, options: LinkOptions, subject: str) -> str | None:
    """Return the reason why the base robot would drop the set points of the controller.

    Returns None if no reason is known. `session` is the controller's session. `subject` is the name
    of the device, for the message.
    """
    if options.certificates is None:
        return None
    allowed = announced(session, options)
    if not allowed or options.controller in allowed:
        return None
    return (
        f"{subject} accepts no commands from certificate {options.controller!r}, only from {', '.join(allowed)}: "
        f"set `controller` to one of the accepted names, or add {options.controller!r} to the base robot's `commanders`"
    )
