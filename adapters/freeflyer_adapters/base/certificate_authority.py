"""A private certificate authority for the machines of one laboratory. All keys are EC P-256."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from freeflyer.foundation.errors import CosimError
from freeflyer.foundation.output_file import write_whole
from freeflyer_adapters.base.certificates import AUTHORITY, Identity, general_name

AUTHORITY_DAYS = 3650
HOSTS = ("localhost", "127.0.0.1", "::1")
"""Default hosts of a certificate for listening. They permit connections within the machine."""
EARLIER = timedelta(minutes=5)
"""A certificate is valid from 5 minutes before the time at which it is made.

The clock of another machine may be behind by up to 5 minutes.
"""


class CertificateError(CosimError):
    """A certificate cannot be made."""


class CertificateAuthority:
    """Certificate authority: the signing key and the certificate of this key."""

    def __init__(self, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> None:
        self.key, self.certificate = key, certificate

    @classmethod
    def new(cls, folder: Path) -> CertificateAuthority:
        """Create an authority and write its certificate and key to `folder`."""
        # The name is random, because the authorities of two laboratories must have different names.
        name = f"freeflyer authority {x509.random_serial_number():x}"[:40]
        start = datetime.now(UTC) - EARLIER
        extensions = [
            (x509.BasicConstraints(ca=True, path_length=0), True),
            (_key_usage(signs_certificates=True), True),
        ]
        end = start + timedelta(days=AUTHORITY_DAYS)
        return cls(*_make(Identity(folder, AUTHORITY), name, start, end, extensions))

    @classmethod
    def read(cls, folder: Path) -> CertificateAuthority:
        """Read an authority from `folder`. Raises CertificateError if the authority cannot sign."""
        where = Identity(folder, AUTHORITY)
        try:
            certificate = x509.load_pem_x509_certificate(where.certificate.read_bytes())
            key = load_pem_private_key(where.key.read_bytes(), password=None)
        except FileNotFoundError as error:
            raise CertificateError(
                f"{error.filename} is missing; the authority cannot sign without this file. The file is on the machine where the authority was made"
            ) from error
        except OSError as error:
            raise CertificateError(
                f"{error.filename} cannot be read: {error.strerror or error}"
            ) from error
        except (ValueError, TypeError) as error:
            raise CertificateError(
                f"{where.certificate} and {where.key} are not a PEM certificate and key"
            ) from error
        if (
            not isinstance(key, ec.EllipticCurvePrivateKey)
            or key.public_key() != certificate.public_key()
        ):
            raise CertificateError(
                f"{where.key} is not the key of {where.certificate}; the key and the certificate of the same authority are expected"
            )
        if certificate.not_valid_after_utc < datetime.now(UTC):
            raise CertificateError(
                f"{where.certificate} expired on {certificate.not_valid_after_utc:%Y-%m-%d}; make a new authority in a new folder"
            )
        return cls(key, certificate)

    def issue(
        self,
        identity: Identity,
        *,
        days: float,
        hosts: Sequence[str],
        may_listen: bool,
        start: datetime | None = None,
    ) -> x509.Certificate:
        """Write a new key and a signed certificate to the folder of `identity`.

        `hosts`: the host names and addresses of the peer. `may_listen`: whether the certificate is
        valid for listening, not only for connecting. `start`: start of the validity (default:
        `EARLIER` before now).

        The validity ends `days` days after `start` + `EARLIER`, but not after the validity of the
        authority's certificate.
        """
        start = start or datetime.now(UTC) - EARLIER
        end = min(start + EARLIER + timedelta(days=days), self.certificate.not_valid_after_utc)
        # The extensions limit the uses and the hosts of the certificate.
        uses = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH][: 1 + may_listen]
        extensions: list[tuple[x509.ExtensionType, bool]] = [
            (x509.BasicConstraints(ca=False, path_length=None), True),
            (_key_usage(signs_certificates=False), True),
            (x509.ExtendedKeyUsage(uses), False),
            (x509.AuthorityKeyIdentifier.from_issuer_public_key(self.key.public_key()), False),
        ]
        if hosts:
            extensions.append((x509.SubjectAlternativeName(map(general_name, hosts)), False))
        return _make(identity, identity.name, start, end, extensions, self)[1]


def _make(
    identity: Identity,
    common_name: str,
    start: datetime,
    end: datetime,
    extensions: Sequence[tuple[x509.ExtensionType, bool]],
    authority: CertificateAuthority | None = None,
) -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
    """Make and write a key and its certificate.

    `extensions`: each extension, and whether it is critical. Without an authority, the certificate
    is signed with its own key.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])
    builder = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(authority.certificate.subject if authority else name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(start)
        .not_valid_after(end)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    for extension, critical in extensions:
        builder = builder.add_extension(extension, critical=critical)
    certificate = builder.sign(authority.key if authority else key, SHA256())
    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    write_whole(identity.key, lambda partial: _write_private(partial, pem))
    data = certificate.public_bytes(Encoding.PEM)
    write_whole(identity.certificate, lambda partial: partial.write_bytes(data))
    return key, certificate


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _write_private(path: Path, data: bytes) -> None:
    """Write a file that only the user can read. Replaces an existing file.

    The file is created with mode 0600, so other users cannot read the data at any time.
    """
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(data)
