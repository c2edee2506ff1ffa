"""Address and encryption of a Zenoh endpoint such as tls/192.0.2.10:7447."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass

ENCRYPTED = ("tls", "quic")
LOCAL = ("unixsock-stream", "unixpipe")
"""Protocols that work within one machine only."""
TLS_KEYS = (  # parts of the names of TLS settings
    "root_ca_",
    "listen_",
    "connect_",
    "enable_mtls",
    "verify_name_on_connect",
    "close_link_on_expiration",
)


@dataclass(frozen=True)
class Endpoint:
    """An endpoint in Zenoh's form, `protocol/address?metadata#configuration`.

    `host` and `port` are valid only if `is_complete` is True.
    """

    text: str

    @property
    def protocol(self) -> str:
        return self.text.partition("/")[0]

    @property
    def address(self) -> str:
        return self.text.partition("/")[2].partition("#")[0].partition("?")[0]

    @property
    def host(self) -> str:
        """The host name or address, without the brackets and the zone of an IPv6 address."""
        host = self.address.rpartition(":")[0]
        return host.strip("[]").partition("%")[0]

    @property
    def port(self) -> int:
        return int(self.address.rpartition(":")[2])

    @property
    def is_complete(self) -> bool:
        """True if the endpoint has a host and a port, or a path."""
        if self.protocol in LOCAL:
            return bool(self.address)
        port = self.address.rpartition(":")[2]
        return bool(self.host) and port.isdecimal() and int(port) < 65536

    @property
    def is_encrypted(self) -> bool:
        return self.protocol in ENCRYPTED

    @property
    def is_within_this_machine(self) -> bool:
        """True for 127.0.0.0/8, ::1, localhost, and the protocols of `LOCAL`.

        Other host names are not resolved: the result for them is False.
        """
        if self.protocol in LOCAL or self.host == "localhost":
            return True
        address = self._number
        mapped = getattr(address, "ipv4_mapped", None)
        return address is not None and (
            address.is_loopback or (mapped is not None and mapped.is_loopback)
        )

    @property
    def is_every_interface(self) -> bool:
        return self._number is not None and self._number.is_unspecified

    @property
    def has_own_tls_settings(self) -> bool:
        """True if the endpoint itself contains TLS settings, after '#'.

        These settings would override the certificates or the TLS checks of the link.
        """
        return any(key in self.text.partition("#")[2] for key in TLS_KEYS)

    @property
    def _number(self) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
        try:
            return ipaddress.ip_address(self.host)
        except ValueError:
            return None
