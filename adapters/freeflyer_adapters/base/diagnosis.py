"""Diagnosis of a link to a base robot from which nothing is received."""

from __future__ import annotations

from typing import Any

from freeflyer_adapters.base import tls_handshake
from freeflyer_adapters.base.certificates import Identity
from freeflyer_adapters.base.endpoint import Endpoint
from freeflyer_adapters.base.options import LinkOptions


def why_silent(session: Any, options: LinkOptions) -> str:
    """Check the endpoints to which the controller connects. Return ': REASON' for a message.

    If the check finds no problem, REASON is a question to the operator. The check takes at most a
    few seconds per endpoint.
    """
    found = [
        problem
        for text in options.connect
        if (problem := _problem(session, options, Endpoint(text)))
    ]
    return f": {'; '.join(found) or 'is the base robot (or `freeflyer facility`) running there?'}"


def _problem(session: Any, options: LinkOptions, endpoint: Endpoint) -> str | None:
    if options.certificates is not None and endpoint.protocol == "tls":
        return tls_handshake.problem(
            endpoint, Identity(options.certificates, options.controller), options.robot
        )
    if endpoint.protocol == "tcp" and not _has_peers(session) and tls_handshake.uses_tls(endpoint):
        return f"TLS is used on {endpoint.text}: `certificates` and tls/{endpoint.address} are expected"
    return None


def _has_peers(session: Any) -> bool:
    return bool(session.info.peers_zid() or session.info.routers_zid())
