"""A Zenoh endpoint such as tls/192.0.2.10:7447: whom it reaches, and whether it is encrypted."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass

ENCRYPTED = ("tls", "quic")
LOCAL = ("unixsock-stream", "unixpipe")
"""Within one machine by their nature."""
TLS_KEYS = (
    "root_ca_",
    "listen_",
    "connect_",
    "enable_mtls",
    "verify_name_on_connect",
    "close_link_on_expiration",
)


@dataclass(frozen=True)
class Endpoint:
    """`protocol/address?metadata#configuration`, as Zenoh writes it; `host` and `port` mean something only where it `is_complete`."""

    text: str

    @property
    def protocol(self) -> str:
        return self.text.partition("/")[0]

    @property
    def address(self) -> str:
        return self.text.partition("/")[2].partition("#")[0].partition("?")[0]

    @property
    def host(self) -> str:
        """Without brackets and zone."""
        host = self.address.rpartition(":")[0]
        return host.strip("[]").partition("%")[0]

    @property
    def port(self) -> int:
        return int(self.address.rpartition(":")[2])

    @property
    def is_complete(self) -> bool:
        """Whether host and port are there, or a path."""
        if self.protocol in LOCAL:
            return bool(self.address)
        port = self.address.rpartition(":")[2]
        return bool(self.host) and port.isdecimal() and int(port) < 65536

    @property
    def is_encrypted(self) -> bool:
        return self.protocol in ENCRYPTED

    @property
    def is_within_this_machine(self) -> bool:
        """127.0.0.0/8, ::1, localhost or a Unix socket; a name is not looked up."""
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
    def says_its_own_tls(self) -> bool:
        """Whether its configuration part would overrule the link's certificates or checks."""
        return any(key in self.text.partition("#")[2] for key in TLS_KEYS)

    @property
    def _number(self) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
        try:
            return ipaddress.ip_address(self.host)
        except ValueError:
            return None
