"""A folder with certificates, and whether one of them can be used: told from its files, before anything is opened.

ca.pem is the authority's certificate, NAME.pem and NAME.key belong to who is called NAME. On a robot's machine lies only what is its own.
"""

from __future__ import annotations

import ipaddress
import re
import stat
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from freeflyer.foundation.suggestions import did_you_mean
from freeflyer_adapters.device.device import DeviceError

AUTHORITY = "ca"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
"""A common name, which is a file's name too and a part of a key expression."""
USES = {ExtendedKeyUsageOID.CLIENT_AUTH: "connecting", ExtendedKeyUsageOID.SERVER_AUTH: "listening"}


@dataclass(frozen=True)
class Identity:
    """Who one is on a link."""

    folder: Path
    name: str

    @property
    def authority(self) -> Path:
        return self.folder / f"{AUTHORITY}.pem"

    @property
    def certificate(self) -> Path:
        return self.folder / f"{self.name}.pem"

    @property
    def key(self) -> Path:
        return self.folder / f"{self.name}.key"


def check(
    identity: Identity, subject: str, *, hosts: Sequence[str] = (), listens: bool = False
) -> x509.Certificate:
    """The certificate, if it can be used to connect (and to listen on `hosts`); else DeviceError with the reason."""
    folder = identity.folder
    if not folder.is_dir():
        raise DeviceError(
            f"{subject}: there is no folder of certificates {folder}; {remedy(folder, identity.name)}"
        )
    authorities = _certificates(identity.authority, subject)
    chain = _certificates(identity.certificate, subject)
    found = chain[0]
    where = f"{subject}: certificate {identity.certificate}"
    if common_name(found) != identity.name:
        raise DeviceError(
            f"{where} is that of {common_name(found)!r}, but access goes by names, and {identity.name!r} is expected"
        )
    _check_key(identity, found, subject)
    _check_dates(
        authorities[0],
        f"{subject}: the authority's certificate {identity.authority}",
        "a new authority is needed",
    )
    _check_dates(found, where, remedy_of_age(identity))
    if not is_issued(chain, authorities):
        raise DeviceError(
            f"{where} was not signed by the authority of {identity.authority} (its issuer calls itself "
            f"{found.issuer.rfc4514_string()!r}); one from there is expected"
        )
    needed = [
        ExtendedKeyUsageOID.CLIENT_AUTH,
        *([ExtendedKeyUsageOID.SERVER_AUTH] if listens else []),
    ]
    for use in needed:
        if not _is_for(found, use):
            raise DeviceError(
                f"{where} is not for {USES[use]} (its extended key usage lacks {use._name}); one made by "
                f"`freeflyer certificates {folder} --name` is"
            )
    known = hosts_of(found)
    for host in hosts:
        if not any(_covers(name, host) for name in known):
            raise DeviceError(
                f"{where} is for {', '.join(known) or 'no host'}, not for {host}, so nobody would accept it there; "
                f"`freeflyer certificates {folder} --renew {identity.name} --host {host}` makes one that is"
            )
    return found


def remedy(folder: Path, name: str) -> str:
    return f"`freeflyer certificates {folder} --name {name}` makes one"


def remedy_of_age(identity: Identity) -> str:
    return f"`freeflyer certificates {identity.folder} --renew {identity.name}` makes a new one"


def common_name(certificate: x509.Certificate) -> str:
    found = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(found[0].value) if found else ""


def hosts_of(certificate: x509.Certificate) -> list[str]:
    """Names and addresses under which its owner may be met."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return [str(name.value) for name in names if isinstance(name, x509.DNSName | x509.IPAddress)]


def written(host: str) -> str:
    """One spelling for each address and name."""
    try:
        return str(ipaddress.ip_address(host))
    except ValueError:
        return host.lower()


def _covers(name: str, host: str) -> bool:
    """A star stands for the first part of a name (RFC 6125, 6.4.3)."""
    name, host = written(name), written(host)
    return name == host or (name.startswith("*.") and name[2:] == host.partition(".")[2])


def general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def is_issued(chain: Sequence[x509.Certificate], authorities: Sequence[x509.Certificate]) -> bool:
    """Whether an authority signed the first of a chain, directly or by way of the others in it."""
    for i, certificate in enumerate(chain):
        if any(_signed(certificate, authority) for authority in authorities):
            return True
        if (
            i + 1 == len(chain)
            or not _is_authority(chain[i + 1])
            or not _signed(certificate, chain[i + 1])
        ):
            return False
    return False


def _is_authority(certificate: x509.Certificate) -> bool:
    try:
        return bool(certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca)
    except x509.ExtensionNotFound:
        return False


def _signed(certificate: x509.Certificate, issuer: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def _is_for(certificate: x509.Certificate, use: x509.ObjectIdentifier) -> bool:
    try:
        return use in certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    except x509.ExtensionNotFound:
        return True  # RFC 5280, 4.2.1.12: without the extension, every use


def _read(path: Path, subject: str) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        others = [found.stem for found in path.parent.glob("*.pem") if found.stem != AUTHORITY]
        near = (
            did_you_mean(path.stem, others)
            if path.suffix == ".pem" and path.stem != AUTHORITY
            else ""
        )
        raise DeviceError(
            f"{subject}: there is no file {path}{near or '; ' + _made(path)}"
        ) from None
    except OSError as error:
        raise DeviceError(f"{subject}: {path} cannot be read: {error.strerror or error}") from error


def _made(path: Path) -> str:
    if path.stem == AUTHORITY:
        return "the authority's certificate is expected beside the others"
    return remedy(path.parent, path.stem)


def _certificates(path: Path, subject: str) -> list[x509.Certificate]:
    try:
        return x509.load_pem_x509_certificates(_read(path, subject))
    except ValueError as error:
        raise DeviceError(
            f"{subject}: {path} is no certificate in PEM ('-----BEGIN CERTIFICATE-----')"
        ) from error


def _check_key(identity: Identity, certificate: x509.Certificate, subject: str) -> None:
    path = identity.key
    data = _read(path, subject)
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        raise DeviceError(
            f"{subject}: key {path} can be used by others (mode {mode:04o}); `chmod 600 {path}` keeps it to you"
        )
    try:
        key = load_pem_private_key(data, password=None)
    except TypeError as error:
        raise DeviceError(
            f"{subject}: key {path} is under a passphrase, which nobody could be asked for; one without is expected"
        ) from error
    except Exception as error:
        raise DeviceError(
            f"{subject}: {path} is no private key in PEM ('-----BEGIN PRIVATE KEY-----')"
        ) from error
    form = (Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    if key.public_key().public_bytes(*form) != certificate.public_key().public_bytes(*form):
        raise DeviceError(
            f"{subject}: key {path} does not belong to certificate {identity.certificate}; both of one pair are expected"
        )


def _check_dates(certificate: x509.Certificate, where: str, then: str) -> None:
    now, begin, end = (
        datetime.now(UTC),
        certificate.not_valid_before_utc,
        certificate.not_valid_after_utc,
    )
    if now > end:
        raise DeviceError(f"{where} expired on {end:%Y-%m-%d %H:%M} UTC; {then}")
    if now < begin:
        raise DeviceError(
            f"{where} is not valid before {begin:%Y-%m-%d %H:%M} UTC, and this machine's clock says {now:%Y-%m-%d %H:%M} UTC"
        )
