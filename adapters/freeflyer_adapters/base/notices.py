"""Notices about the protection of the base robot's link, printed before the link is opened."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

from cryptography import x509

from freeflyer.scenario.scenario import Scenario
from freeflyer_adapters.base import options as link_options
from freeflyer_adapters.base.certificates import Identity, remedy_of_age
from freeflyer_adapters.base.endpoint import Endpoint
from freeflyer_adapters.base.options import LinkOptions

KIND = "zenoh_base"
SOON_DAYS = 30


def notices(scenario: Scenario, *, as_robot: bool) -> Iterator[str]:
    """Yield notices of one line each, for one end of the link.

    `as_robot`: True for the base robot's end, False for the controller's end. Raises DeviceError if
    the table `[devices.NAME]` of a device is not valid.
    """
    for spec in scenario.devices:
        if spec.kind == KIND:
            options = link_options.options_from(spec.name, spec.options, scenario.directory)
            yield from (f"{spec.name}: {text}" for text in _of_link(options, as_robot))


def _of_link(options: LinkOptions, as_robot: bool) -> Iterator[str]:
    # The endpoints `connect` of the controller are the endpoints on which the base robot listens.
    listening = [Endpoint(text) for text in (options.connect if as_robot else options.listen)]
    endpoints = [*listening, *(Endpoint(text) for text in options.connect if not as_robot)]
    for endpoint in endpoints:
        if options.certificates is None and not endpoint.is_within_this_machine:
            yield f"WARNING: {endpoint.text} is not encrypted, so any peer that reaches this endpoint can command the robot (insecure = true)"
    for endpoint in listening:
        if endpoint.is_every_interface:
            yield f"{endpoint.text} listens on every interface of this machine"
    if options.certificates is not None:
        yield from _of_certificate(
            Identity(options.certificates, options.robot if as_robot else options.controller)
        )


def _of_certificate(identity: Identity) -> Iterator[str]:
    try:
        end = x509.load_pem_x509_certificate(identity.certificate.read_bytes()).not_valid_after_utc
    except (OSError, ValueError):
        return  # opening the link reports the error
    days = (end - datetime.now(UTC)).days
    yield f"TLS with certificate {identity.name!r}, valid until {end:%Y-%m-%d}"
    if 0 <= days < SOON_DAYS:
        yield f"WARNING: certificate {identity.name!r} expires in {days} days, and all links with this certificate end at that time; {remedy_of_age(identity)}"
