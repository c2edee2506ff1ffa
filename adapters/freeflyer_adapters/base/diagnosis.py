"""Why nothing comes over the base robot's link, as the end of a sentence."""

from __future__ import annotations

from typing import Any

from freeflyer_adapters.base import tls_handshake
from freeflyer_adapters.base.certificates import Identity
from freeflyer_adapters.base.endpoint import Endpoint
from freeflyer_adapters.base.options import LinkOptions


def why_silent(session: Any, options: LinkOptions) -> str:
    """': REASON' for what a look at the endpoints finds, else a question. Takes a few seconds an endpoint at most."""
    found = [
        trouble
        for text in options.connect
        if (trouble := _trouble(session, options, Endpoint(text)))
    ]
    return f": {'; '.join(found) or 'is the base robot (or `freeflyer facility`) running there?'}"


def _trouble(session: Any, options: LinkOptions, endpoint: Endpoint) -> str | None:
    if options.certificates is not None and endpoint.protocol == "tls":
        return tls_handshake.trouble(
            endpoint, Identity(options.certificates, options.controller), options.robot
        )
    if (
        endpoint.protocol == "tcp"
        and not _has_peers(session)
        and tls_handshake.speaks_tls(endpoint)
    ):
        return f"TLS is spoken on {endpoint.text}: `certificates` and tls/{endpoint.address} are expected"
    return None


def _has_peers(session: Any) -> bool:
    return bool(session.info.peers_zid() or session.info.routers_zid())
