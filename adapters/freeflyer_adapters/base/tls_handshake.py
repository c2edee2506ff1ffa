"""Diagnosis of a TLS endpoint by a separate handshake.

If a handshake fails, Zenoh tries again and does not return the error. So this module makes a
separate handshake to find the error. In the messages, "our certificate" is the certificate that
this process sends.
"""

from __future__ import annotations

import socket
import ssl
from contextlib import closing

from cryptography import x509

from freeflyer_adapters.base.certificates import Identity, common_name, hosts_of
from freeflyer_adapters.base.endpoint import Endpoint

PATIENCE = 2.0
"""Timeout of a TCP connection, and of each read or write during a handshake [s]."""
SILENCE = 1.0
"""Time to wait for a TLS alert after the handshake [s].

If no alert arrives in this time, the peer has accepted our certificate.
"""
ANOTHER_AUTHORITY = (18, 19, 20, 21)
NOT_YET, EXPIRED, OTHER_NAME, OTHER_ADDRESS = 9, 10, 62, 64
"""Error codes X509_V_ERR_* of OpenSSL. `ANOTHER_AUTHORITY` contains such codes, too."""
ALERTS = {
    "CERTIFICATE_REQUIRED": "it requires a certificate, but no certificate was sent",
    "UNKNOWN_CA": "it does not trust the authority that signed our certificate",
    "CERTIFICATE_EXPIRED": "our certificate has expired according to the clock of the peer",
    "CERTIFICATE_REVOKED": "our certificate was revoked",
    "BAD_CERTIFICATE": "our certificate cannot be used",
    "CERTIFICATE_UNKNOWN": "our certificate is not accepted",
    "UNSUPPORTED_CERTIFICATE": "our certificate has a type that is not accepted",
    "DECRYPT_ERROR": "our certificate was not signed by the authority that it names as its issuer",
    "ACCESS_DENIED": "our certificate has no access rights",
}
"""TLS alerts (RFC 8446, 6.2) by which a peer rejects a certificate."""


def problem(endpoint: Endpoint, identity: Identity | None, peer: str | None) -> str | None:
    """Return the problem of an endpoint as a clause, or None if a handshake succeeds.

    If `identity` is None, no certificate is sent and no certificate is verified. `peer` is the
    expected common name in the certificate of the peer.
    """
    # Open the TCP connection.
    try:
        connection = socket.create_connection((endpoint.host, endpoint.port), PATIENCE)
    except ConnectionRefusedError:
        return f"nothing listens on {endpoint.text}"
    except socket.gaierror:
        return f"the host name {endpoint.host!r} cannot be resolved"
    except TimeoutError:
        return f"{endpoint.host} does not answer within {PATIENCE:g} s"
    except OSError as error:
        return f"{endpoint.text} cannot be reached: {error.strerror or error}"
    # Make the TLS handshake. The server may reject our certificate during or after the handshake.
    with closing(connection):
        try:
            with _context(identity).wrap_socket(connection, server_hostname=endpoint.host) as tls:
                found = tls.getpeercert(binary_form=True)
                refused = _refusal(tls, endpoint)
        except ssl.SSLCertVerificationError as error:
            return _not_trusted(endpoint, error)
        except ssl.SSLError as error:
            return (
                _alert(endpoint, error)
                or f"the server on {endpoint.text} does not use TLS ({_reason(error)})"
            )
        except TimeoutError:
            return f"the server on {endpoint.text} does not use TLS (probably plain TCP)"
        except OSError as error:
            return f"{endpoint.text} aborts the handshake: {error.strerror or error}"
    # The certificate of the peer must have the expected name.
    if refused or identity is None or found is None:
        return refused
    name = common_name(x509.load_der_x509_certificate(found))
    if peer is not None and name != peer:
        return f"the certificate on {endpoint.text} belongs to {name!r}, but {peer!r} is expected there (the device's option `robot`)"
    return None


def uses_tls(endpoint: Endpoint) -> bool:
    """Return True if the server on the endpoint uses TLS.

    The server uses TLS if a handshake without certificates succeeds, or fails only because of a
    certificate.
    """
    return (found := problem(endpoint, None, None)) is None or "certificate" in found


def _context(identity: Identity | None) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    if identity is None:
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    else:
        context.load_verify_locations(identity.authority)
        context.load_cert_chain(identity.certificate, identity.key)
    return context


def _refusal(tls: ssl.SSLSocket, endpoint: Endpoint) -> str | None:
    """Return the reason why the server rejects our certificate, or None.

    In TLS 1.3, the rejection arrives after the client has completed the handshake.
    """
    tls.settimeout(SILENCE)
    try:
        if tls.recv(1) == b"":
            return f"{endpoint.text} ends the connection without a reason"
    except ssl.SSLError as error:
        return _alert(endpoint, error) or f"{endpoint.text} ends the connection: {_reason(error)}"
    except TimeoutError:
        return None
    except OSError as error:
        return f"{endpoint.text} ends the connection: {error.strerror or error}"
    return None


def _reason(error: ssl.SSLError) -> str:
    return str(error.reason or error).replace("_", " ").lower()


def _alert(endpoint: Endpoint, error: ssl.SSLError) -> str | None:
    found = str(error.reason or "")
    meaning = next((text for name, text in ALERTS.items() if found.endswith(name)), None)
    return (
        meaning
        and f"{endpoint.text} rejects our certificate: {meaning} (TLS alert: {_reason(error)})"
    )


def _not_trusted(endpoint: Endpoint, error: ssl.SSLCertVerificationError) -> str:
    found = _shown(endpoint)
    what = f"the certificate on {endpoint.text}" + (f", {common_name(found)!r}," if found else "")
    if error.verify_code in ANOTHER_AUTHORITY:
        return f"{what} was signed by another authority than ours; a certificate made in the same `freeflyer certificates` folder is expected"
    if error.verify_code == EXPIRED:
        return f"{what} has expired" + (
            f" on {found.not_valid_after_utc:%Y-%m-%d %H:%M} UTC" if found else ""
        )
    if error.verify_code == NOT_YET:
        return f"{what} is not valid yet" + (
            f" (valid from {found.not_valid_before_utc:%Y-%m-%d %H:%M} UTC)" if found else ""
        )
    if error.verify_code in (OTHER_NAME, OTHER_ADDRESS):
        known = f"for {', '.join(hosts_of(found)) or 'no host'}, " if found else ""
        return f"{what} is {known}not for {endpoint.host}; `freeflyer certificates DIR --renew NAME --host {endpoint.host}` makes a certificate for this host"
    return f"{what} cannot be trusted: {error.verify_message}"


def _shown(endpoint: Endpoint) -> x509.Certificate | None:
    """Return the certificate of the endpoint without verification, for messages only."""
    try:
        with (
            socket.create_connection((endpoint.host, endpoint.port), PATIENCE) as connection,
            _context(None).wrap_socket(connection, server_hostname=endpoint.host) as tls,
        ):
            der = tls.getpeercert(binary_form=True)
            return x509.load_der_x509_certificate(der) if der else None
    except (OSError, ValueError):
        return None
