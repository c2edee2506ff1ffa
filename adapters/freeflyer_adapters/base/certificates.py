"""Checks of the certificate files of a link, before the link is opened.

The files are in one folder. ca.pem is the certificate of the authority. NAME.pem and NAME.key are
the certificate and the private key of the peer NAME. On the machine of a base robot, the folder
contains only ca.pem and the two files of this base robot.
"""

from __future__ import annotations

import ipaddress
import re
import stat
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from freeflyer.foundation.suggestions import did_you_mean
from freeflyer_adapters.foundation.errors import DeviceError

AUTHORITY = "ca"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
"""Pattern of a certificate's common name. File names and key expressions also contain this name."""
E = TypeVar("E", bound=x509.ExtensionType)
USES = {ExtendedKeyUsageOID.CLIENT_AUTH: "connecting", ExtendedKeyUsageOID.SERVER_AUTH: "listening"}


@dataclass(frozen=True)
class Identity:
    """The identity of one end of a link: the folder of its files, and its common name."""

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


def names_in(folder: Path) -> list[str]:
    """Return the names that have a certificate in the folder."""
    return sorted(path.stem for path in folder.glob("*.pem") if path.stem != AUTHORITY)


def check(
    identity: Identity, subject: str, *, hosts: Sequence[str] = (), listens: bool = False
) -> x509.Certificate:
    """Check and return the certificate of `identity`.

    The certificate must be valid for connecting, and must name all `hosts`. If `listens` is True,
    the certificate must also be valid for listening. `subject` is the name of the device, for
    messages. Raises DeviceError if the certificate or the key cannot be used.
    """
    folder = identity.folder
    if not folder.is_dir():
        raise DeviceError(
            f"{subject}: there is no folder of certificates {folder}; {remedy(folder, identity.name)}"
        )
    # The files must be readable. The certificate must have the expected name and a valid date, and
    # must be signed by the authority.
    authorities = _certificates(identity.authority, subject)
    chain = _certificates(identity.certificate, subject)
    found = chain[0]
    where = f"{subject}: certificate {identity.certificate}"
    if common_name(found) != identity.name:
        raise DeviceError(
            f"{where} belongs to {common_name(found)!r}, but {identity.name!r} is expected, because access is granted by name"
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
            f"{where} was not signed by the authority of {identity.authority} (its issuer is "
            f"{found.issuer.rfc4514_string()!r}); a certificate of that authority is expected"
        )
    # The certificate must be valid for the needed uses (connecting, listening) and for all hosts.
    needed = [
        ExtendedKeyUsageOID.CLIENT_AUTH,
        *([ExtendedKeyUsageOID.SERVER_AUTH] if listens else []),
    ]
    for use in needed:
        if not is_for(found, use):
            raise DeviceError(
                f"{where} is not for {USES[use]} (its extended key usage lacks {use._name}); "
                f"`freeflyer certificates {folder} --name` makes a certificate for connecting and listening"
            )
    known = hosts_of(found)
    for host in hosts:
        if not any(_covers(name, host) for name in known):
            raise DeviceError(
                f"{where} is for {', '.join(known) or 'no host'}, not for {host}, so peers would reject the certificate on this host; "
                f"`freeflyer certificates {folder} --renew {identity.name} --host {host}` makes a certificate for this host"
            )
    return found


def remedy(folder: Path, name: str) -> str:
    return f"`freeflyer certificates {folder} --name {name}` makes it"


def remedy_of_age(identity: Identity) -> str:
    return f"`freeflyer certificates {identity.folder} --renew {identity.name}` makes a new certificate"


def common_name(certificate: x509.Certificate) -> str:
    """Return the common name of the subject, or an empty string if there is no common name."""
    found = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(found[0].value) if found else ""


def hosts_of(certificate: x509.Certificate) -> list[str]:
    """Return the host names and addresses of the certificate (subject alternative names)."""
    names = _extension(certificate, x509.SubjectAlternativeName) or ()
    return [str(name.value) for name in names if isinstance(name, x509.DNSName | x509.IPAddress)]


def is_for(certificate: x509.Certificate, use: x509.ObjectIdentifier) -> bool:
    """Return True if the certificate is valid for the extended key usage `use`.

    A certificate without this extension is valid for every use (RFC 5280, 4.2.1.12).
    """
    uses = _extension(certificate, x509.ExtendedKeyUsage)
    return uses is None or use in uses


def _extension(certificate: x509.Certificate, kind: type[E]) -> E | None:
    try:
        return certificate.extensions.get_extension_for_class(kind).value
    except x509.ExtensionNotFound:
        return None


def written(host: str) -> str:
    """Return the normalised spelling of an address or name."""
    try:
        return str(ipaddress.ip_address(host))
    except ValueError:
        return host.lower()


def _covers(name: str, host: str) -> bool:
    """Return True if the name in a certificate covers the host.

    A wildcard can replace the first label of a host name (RFC 6125, 6.4.3).
    """
    name, host = written(name), written(host)
    return name == host or (name.startswith("*.") and name[2:] == host.partition(".")[2])


def general_name(host: str) -> x509.GeneralName:
    """Return a host name or address as an entry of the subject alternative names."""
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def is_issued(chain: Sequence[x509.Certificate], authorities: Sequence[x509.Certificate]) -> bool:
    """Return True if the first certificate of `chain` can be traced back to one of `authorities`.

    The function follows `chain` to the first certificate that one of `authorities` has signed. Up
    to this certificate, each certificate must be signed by the next certificate of `chain`.
    """
    for i, certificate in enumerate(chain):
        if any(_signed(certificate, authority) for authority in authorities):
            return True
        # The certificate must be signed by the next one, which must be allowed to sign.
        for issuer in chain[i + 1 : i + 2]:
            constraints = _extension(issuer, x509.BasicConstraints)
            if constraints is None or not constraints.ca or not _signed(certificate, issuer):
                return False
    return False


def _signed(certificate: x509.Certificate, issuer: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def _read(path: Path, subject: str) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        if path.stem == AUTHORITY:
            hint = "; copy the certificate of the authority into this folder"
        else:
            near = did_you_mean(path.stem, names_in(path.parent)) if path.suffix == ".pem" else ""
            hint = near or f"; {remedy(path.parent, path.stem)}"
        raise DeviceError(f"{subject}: there is no file {path}{hint}") from None
    except OSError as error:
        raise DeviceError(f"{subject}: {path} cannot be read: {error.strerror or error}") from error


def _certificates(path: Path, subject: str) -> list[x509.Certificate]:
    try:
        return x509.load_pem_x509_certificates(_read(path, subject))
    except ValueError as error:
        raise DeviceError(
            f"{subject}: {path} is not a PEM certificate ('-----BEGIN CERTIFICATE-----')"
        ) from error


def _check_key(identity: Identity, certificate: x509.Certificate, subject: str) -> None:
    path = identity.key
    data = _read(path, subject)
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        raise DeviceError(
            f"{subject}: key {path} is accessible to other users (mode {mode:04o}); `chmod 600 {path}` removes the access of other users"
        )
    try:
        key = load_pem_private_key(data, password=None)
    except TypeError as error:
        raise DeviceError(
            f"{subject}: key {path} is protected by a passphrase; a key without passphrase is expected"
        ) from error
    except Exception as error:
        raise DeviceError(
            f"{subject}: {path} is not a PEM private key ('-----BEGIN PRIVATE KEY-----')"
        ) from error
    form = (Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    if key.public_key().public_bytes(*form) != certificate.public_key().public_bytes(*form):
        raise DeviceError(
            f"{subject}: key {path} does not belong to certificate {identity.certificate}; a key and a certificate that belong together are expected"
        )


def _check_dates(certificate: x509.Certificate, where: str, then: str) -> None:
    start, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if (now := datetime.now(UTC)) > end:
        raise DeviceError(f"{where} expired on {end:%Y-%m-%d %H:%M} UTC; {then}")
    if now < start:
        raise DeviceError(
            f"{where} is not valid before {start:%Y-%m-%d %H:%M} UTC, but the clock of this machine is at {now:%Y-%m-%d %H:%M} UTC"
        )
