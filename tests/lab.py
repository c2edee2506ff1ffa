"""Valid and invalid certificates of a lab, and Zenoh sessions on the loopback interface."""

from __future__ import annotations

import contextlib
import json
import shutil
import socket
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import zenoh

from freeflyer_adapters.base.certificate_authority import HOSTS, CertificateAuthority
from freeflyer_adapters.base.certificates import Identity
from freeflyer_adapters.base.options import LinkOptions

NAMES = ("controller", "base_robot", "other_robot")


def waited(condition: Callable[[], bool], timeout: float = 5.0) -> bool:
    """Wait until the condition holds; return False after `timeout` [s]."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return False


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def make_folder(folder: Path) -> CertificateAuthority:
    """Create an authority with certificates for a controller, two robots and an observer."""
    folder.mkdir(mode=0o700)
    authority = CertificateAuthority.new(folder)
    for name in NAMES:
        authority.issue(Identity(folder, name), days=30, hosts=HOSTS, may_listen=True)
    authority.issue(Identity(folder, "observer"), days=30, hosts=(), may_listen=False)
    return authority


class Lab:
    """Folders with certificates.

    `good` and `rogue` belong to two authorities. `expired` has certificates of the good authority
    for the same names, but they have expired. `forged` has the good authority's certificate, which
    is public, but its other certificates have the rogue authority's signature.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        self.good, self.rogue, self.expired = folder / "good", folder / "rogue", folder / "expired"
        authority = make_folder(self.good)
        make_folder(self.rogue)
        shutil.copytree(self.good, self.expired)
        long_ago = datetime.now(UTC) - timedelta(days=9)
        for name in NAMES:
            authority.issue(
                Identity(self.expired, name), days=2, hosts=HOSTS, may_listen=True, start=long_ago
            )
        self.authority = authority
        self.forged = folder / "forged"
        shutil.copytree(self.rogue, self.forged)
        shutil.copy(self.good / "ca.pem", self.forged / "ca.pem")

    @staticmethod
    def options(
        folder: Path | None, port: int, protocol: str = "tls", **changes: Any
    ) -> LinkOptions:
        endpoint = f"{'tcp' if folder is None else protocol}/127.0.0.1:{port}"
        listen = ("tls/127.0.0.1:0",) if folder else ("tcp/127.0.0.1:0",)
        return LinkOptions(connect=(endpoint,), listen=listen, certificates=folder, **changes)


def session_without_checks(
    *,
    connect: str | None = None,
    listen: str | None = None,
    authority: Path | None = None,
    own: Identity | None = None,
    zid: str | None = None,
) -> zenoh.Session:
    """Open a session without this project's checks of files and without access control."""
    config = zenoh.Config()
    tls = "transport/link/tls"
    settings: dict[str, Any] = {
        "mode": "peer",
        "connect/endpoints": [connect] if connect else [],
        "connect/timeout_ms": 1000,
        "connect/exit_on_failure": False,
        "listen/endpoints": [listen or "tcp/127.0.0.1:0"],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
    }
    if zid is not None:
        settings["id"] = zid
    if authority is not None:
        settings |= {
            f"{tls}/root_ca_certificate": str(authority),
            f"{tls}/enable_mtls": own is not None,
        }
    if own is not None:
        settings |= {
            f"{tls}/{side}_certificate": str(own.certificate) for side in ("connect", "listen")
        }
        settings |= {f"{tls}/{side}_private_key": str(own.key) for side in ("connect", "listen")}
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


class Wiretap:
    """A TCP relay in front of a port that stores every byte that it forwards."""

    def __init__(self, port: int) -> None:
        self.bytes = bytearray()
        self._target = port
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self._sockets: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept, daemon=True)]
        self._threads[0].start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._server.accept()
                far = socket.create_connection(("127.0.0.1", self._target))
                self._sockets += [near, far]
                for a, b in ((near, far), (far, near)):
                    self._threads.append(
                        threading.Thread(target=self._relay, args=(a, b), daemon=True)
                    )
                    self._threads[-1].start()

    def _relay(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                self.bytes += data
                sink.sendall(data)

    def close(self) -> None:
        self._server.shutdown(socket.SHUT_RDWR)
        for one in (self._server, *self._sockets):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        for thread in self._threads:
            thread.join(5.0)
