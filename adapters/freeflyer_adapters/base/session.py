"""A Zenoh session that only uses the given endpoints.

If the link has certificates, the session uses mutual TLS.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import zenoh

from freeflyer.foundation.errors import one_line
from freeflyer_adapters.base import certificates
from freeflyer_adapters.base.access_control import Protection
from freeflyer_adapters.base.endpoint import Endpoint
from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.errors import DeviceError


def open_session(
    connect: Sequence[str],
    listen: Sequence[str],
    subject: str,
    protection: Protection | None = None,
) -> Any:
    """Open a Zenoh session in peer mode.

    `subject`: name of the device, for messages. `protection`: certificate and access control of
    this end of the link, or None for a link without certificates.

    Raises DeviceError if an endpoint or a certificate cannot be used.
    """
    settings: dict[str, Any] = {
        "mode": "peer",
        "connect/endpoints": list(connect),
        "connect/timeout_ms": 2000,
        "connect/exit_on_failure": False,
        "listen/endpoints": list(listen),
        "listen/exit_on_failure": True,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
    }
    if protection is not None:
        listeners = [Endpoint(text) for text in listen] if protection.listens_for_others else []
        hosts = [e.host for e in listeners if not e.is_every_interface]
        certificates.check(
            protection.identity, subject, hosts=hosts, listens=protection.listens_for_others
        )
        settings |= _protected(protection)
    config = zenoh.Config()
    for key, value in settings.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise DeviceError(
                f"{subject}: Zenoh rejects {key} = {value!r}: {zenoh_message(error)}"
            ) from error
    try:
        return environment.present().session(config)
    except zenoh.ZError as error:
        raise DeviceError(
            f"{subject}: a Zenoh session (listening on {', '.join(listen)}, connecting to {', '.join(connect) or 'no endpoint'}) cannot be "
            f"opened: {zenoh_message(error)}"
        ) from error


def _protected(protection: Protection) -> Mapping[str, Any]:
    """Return the settings of mutual TLS and of the access control."""
    identity, tls = protection.identity, "transport/link/tls"
    return {
        f"{tls}/root_ca_certificate": str(identity.authority),
        f"{tls}/enable_mtls": True,
        f"{tls}/verify_name_on_connect": True,
        f"{tls}/close_link_on_expiration": True,
        **{
            f"{tls}/{side}_certificate": str(identity.certificate) for side in ("listen", "connect")
        },
        **{f"{tls}/{side}_private_key": str(identity.key) for side in ("listen", "connect")},
        "access_control": dict(protection.access),
    }


def zenoh_message(error: Exception) -> str:
    """Return the message of a Zenoh error, without file names and line numbers of Zenoh."""
    return one_line(str(error).split(" at ")[0], 200)
