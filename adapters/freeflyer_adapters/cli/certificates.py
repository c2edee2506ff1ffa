"""`freeflyer certificates`."""

from __future__ import annotations

import argparse
import ipaddress
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID
from rich.console import Console

from freeflyer.foundation.exit_codes import DONE
from freeflyer.foundation.output_file import check_writable, folder
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer_adapters.base.certificate_authority import (
    HOSTS,
    CertificateAuthority,
    CertificateError,
)
from freeflyer_adapters.base.certificates import (
    AUTHORITY,
    NAME,
    Identity,
    hosts_of,
    is_for,
    names_in,
    written,
)

NAMES = ("controller", "base_robot")
"""Default names: one controller and one base robot."""
DAYS = 365.0
"""Default validity of a certificate [days]."""
LONGEST = 3650.0
"""Longest validity of a certificate [days]."""
HOST = re.compile(
    r"(?=.{1,253}$)[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?(\.[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?)*"
)
"""A host name by RFC 1123."""


class CertificatesCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "directory",
            type=folder,
            metavar="DIR",
            help="folder of the certificate authority; if the folder has no authority, a new authority is made",
        )
        several = partial(parser.add_argument, action="append", default=[])
        # The peers that get a certificate.
        several(
            "--name",
            metavar="NAME",
            help=f"make a certificate for a peer that connects and listens (default: {' and '.join(NAMES)})",
        )
        several(
            "--observer",
            metavar="NAME",
            help="make a certificate for a peer that only connects, to read measurements",
        )
        several(
            "--host",
            metavar="HOST",
            help=f"host name or address of the peers of --name, in addition to {', '.join(HOSTS)}",
        )
        # The validity, and the replacement of certificates.
        days = "validity of the certificates in days (default: 365)"
        parser.add_argument("--days", type=float, default=DAYS, metavar="N", help=days)
        several(
            "--renew", metavar="NAME", help="replace the certificate and key of an existing name"
        )

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        directory: Path = arguments.directory
        names, observers, renewed = arguments.name, arguments.observer, arguments.renew
        if not names and not observers and not renewed:
            names = list(NAMES)
        # Check all arguments before a file is written.
        _check(directory, names + observers, renewed, arguments.host, arguments.days)
        check_writable(directory)
        before = {name: _read(Identity(directory, name)) for name in renewed}
        is_new = not Identity(directory, AUTHORITY).certificate.exists()
        authority = _authority(directory, is_new)
        if is_new:
            console.print(
                f"{directory}/{AUTHORITY}.pem, {AUTHORITY}.key: a new authority", soft_wrap=True
            )
        # A renewed certificate keeps the uses and hosts of the old certificate. If it is valid for
        # listening, the hosts of --host are added.
        for name in [*names, *observers, *renewed]:
            old = before.get(name)
            may_listen = is_for(old, ExtendedKeyUsageOID.SERVER_AUTH) if old else name in names
            kept = hosts_of(old) if old else HOSTS if may_listen else ()
            hosts = _united(kept, arguments.host if may_listen else ())
            made = authority.issue(
                Identity(directory, name), days=arguments.days, hosts=hosts, may_listen=may_listen
            )
            use = f"connects, and listens on {', '.join(hosts)}" if may_listen else "connects only"
            console.print(
                f"{directory}/{name}.pem, {name}.key: {use}; valid until {made.not_valid_after_utc:%Y-%m-%d}",
                soft_wrap=True,
            )
        console.print(_next_step(directory), soft_wrap=True)
        return DONE


def _check(
    directory: Path, names: Sequence[str], renewed: Sequence[str], hosts: Sequence[str], days: float
) -> None:
    """Check all arguments. Raises CertificateError if an argument is not valid.

    `names`: new names. `renewed`: names with a certificate that is to be replaced.
    """
    # Check the names, the hosts and the validity.
    for name in [*names, *renewed]:
        if not NAME.fullmatch(name) or name == AUTHORITY:
            raise CertificateError(
                f"{name!r} is not a valid certificate name; 1 to 64 letters, digits, '_', '.' and '-' are expected; the name {AUTHORITY!r} is reserved"
            )
    if twice := next((name for name in names if [*names, *renewed].count(name) > 1), None):
        raise CertificateError(
            f"{twice!r} is named more than once; each name is expected only once"
        )
    for host in hosts:
        if not _is_host(host):
            raise CertificateError(
                f"--host {host!r} is neither a host name nor an address; 192.0.2.10 or robot.lab.example is expected"
            )
    if not 0.0 < days <= LONGEST:
        raise CertificateError(
            f"--days {days:g}: more than 0 and at most {LONGEST:g} days are expected"
        )
    if directory.exists() and not directory.is_dir():
        raise CertificateError(f"{directory} is a file; a directory is expected")
    # A new name must not exist yet. A name to renew must exist.
    for name in names:
        identity = Identity(directory, name)
        for path in (identity.certificate, identity.key):
            if path.exists():
                raise CertificateError(
                    f"{path} exists already and is not overwritten; use --renew {name} to replace this certificate and its key"
                )
    for name in renewed:
        if not Identity(directory, name).certificate.exists():
            hint = did_you_mean(name, names_in(directory))
            raise CertificateError(f"--renew {name}: there is no {directory}/{name}.pem{hint}")


def _is_host(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return HOST.fullmatch(host) is not None and not host.replace(".", "").isdecimal()
    return True


def _authority(directory: Path, is_new: bool) -> CertificateAuthority:
    if not is_new:
        return CertificateAuthority.read(directory)
    key = Identity(directory, AUTHORITY).key
    if key.exists():
        raise CertificateError(
            f"{key} exists without its certificate and is not overwritten; another directory is expected"
        )
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    return CertificateAuthority.new(directory)


def _read(identity: Identity) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(identity.certificate.read_bytes())
    except (OSError, ValueError) as error:
        raise CertificateError(
            f"{identity.certificate} is not a certificate that can be renewed"
        ) from error


def _united(hosts: Sequence[str], more: Sequence[str]) -> list[str]:
    """Return `hosts` and then `more`, normalised and without duplicates."""
    return list(dict.fromkeys(written(host) for host in [*hosts, *more]))


def _next_step(directory: Path) -> str:
    return (
        f'Next: set certificates = "{directory}" and tls/ endpoints in [devices.base_robot] of your scenario. Copy {AUTHORITY}.pem to every other machine, '
        f"and the .pem and .key of each name to the machine that uses this name. Use a channel that you trust. Never copy {AUTHORITY}.key (docs/security.md)"
    )
