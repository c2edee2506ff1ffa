"""Whom a base robot lets command, told by itself: one liveliness token for each, which only a link with certificates carries.

Zenoh drops what access control denies without a word to the sender. With these tokens a controller learns that it has no right to command
before it sends anything; what enforces it is the base robot's access control.
"""

from __future__ import annotations

from typing import Any

from freeflyer_adapters.base import rmw_zenoh
from freeflyer_adapters.base.options import LinkOptions


def announce(session: Any, options: LinkOptions) -> list[Any]:
    """The tokens, which live as long as the session; none on a link without certificates."""
    if options.certificates is None:
        return []
    keys = [
        rmw_zenoh.commander_token(options.domain, options.setpoint_topic, name)
        for name in options.commanders
    ]
    return [session.liveliness().declare_token(key) for key in keys]


def announced(session: Any, options: LinkOptions) -> list[str]:
    """Whom the base robot lets command; empty if it does not tell."""
    key = rmw_zenoh.commander_token(options.domain, options.setpoint_topic, "*")
    replies = session.liveliness().get(key, timeout=1.0)
    return sorted(
        str(reply.ok.key_expr).rsplit("/", 1)[1] for reply in replies if reply.ok is not None
    )


def refusal(session: Any, options: LinkOptions, subject: str) -> str | None:
    """Why set points of this session would be dropped, if the base robot tells."""
    if options.certificates is None:
        return None
    allowed = announced(session, options)
    if not allowed or options.controller in allowed:
        return None
    return (
        f"{subject} does not let certificate {options.controller!r} command, only {', '.join(allowed)}: "
        f"name one of them as `controller`, or this one among the base robot's `commanders`"
    )
