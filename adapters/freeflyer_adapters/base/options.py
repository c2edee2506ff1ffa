"""Options of a scenario's table `[devices.NAME]` of kind "zenoh_base".

Both ends of the link, the controller and the virtual base robot, use these options.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from freeflyer_adapters.base import rmw_zenoh
from freeflyer_adapters.base.certificates import AUTHORITY, NAME
from freeflyer_adapters.base.endpoint import Endpoint
from freeflyer_adapters.device.option_checks import checked, known_keys
from freeflyer_adapters.foundation.errors import DeviceError

LONGEST_FRAME = 200
"""Longest frame name [bytes]."""


@dataclass(frozen=True, kw_only=True)
class LinkOptions:
    """Options of the link, with endpoints in Zenoh's form.

    `connect` and `listen` are the endpoints of the controller. The virtual base robot listens on
    the endpoints of `connect`. Multicast and gossip of Zenoh are off, so only these endpoints are
    used.

    `certificates` is a folder. If it is given, each end authenticates with its own files in this
    folder. Without certificates, endpoints outside this machine are accepted only if the scenario
    sets `insecure`.
    """

    connect: Sequence[str] = ("tcp/127.0.0.1:7447",)
    listen: Sequence[str] = ("tcp/127.0.0.1:0",)
    domain: int = 0
    setpoint_topic: str = "base_robot/setpoint"
    measured_topic: str = "base_robot/measured"
    frame: str = "inertial"
    child_frame: str = "base"
    node: str = "freeflyer"
    certificates: Path | None = None
    """Folder made by `freeflyer certificates`.

    The folder contains ca.pem, and for each name a certificate and a key.
    """
    controller: str = "controller"
    """Common name of the controller's certificate."""
    robot: str = "base_robot"
    """Common name of the base robot's certificate.

    The default in a scenario is the name of the device.
    """
    commanders: Sequence[str] = ("controller",)
    """Certificate names of the controllers that may command the base robot.

    The default in a scenario is the name in `controller`.
    """
    insecure: bool = False


def check(options: LinkOptions, subject: str) -> None:
    """Check all options. Raises DeviceError if an option is not valid.

    `subject` is the name of the device, for messages.
    """
    # Check the endpoints.
    for key in ("connect", "listen"):
        endpoints = getattr(options, key)
        if isinstance(endpoints, str) or not all(
            isinstance(e, str) and "/" in e for e in endpoints
        ):
            raise DeviceError(
                f"{subject}: {key} is {endpoints!r}; a list of endpoints such as 'tcp/127.0.0.1:7447' is expected"
            )
    if not options.listen:
        raise DeviceError(
            f"{subject}: listen is empty, so Zenoh would listen on every interface; at least one endpoint is expected"
        )
    for text in (*options.connect, *options.listen):
        _check_endpoint(Endpoint(text), options, subject)
    if options.certificates is not None and options.insecure:
        raise DeviceError(
            f"{subject}: insecure = true and certificates exclude each other; remove one of the two options"
        )
    # Check the names of certificates.
    for key, names in (
        ("controller", [options.controller]),
        ("robot", [options.robot]),
        ("commanders", options.commanders),
    ):
        for name in names:
            if not isinstance(name, str) or not NAME.fullmatch(name) or name == AUTHORITY:
                raise DeviceError(
                    f"{subject}: {key} is {name!r}; the name of a certificate is expected: up to 64 letters, digits, '_', '.' and '-'"
                )
    if not options.commanders:
        raise DeviceError(
            f"{subject}: commanders is empty, so no controller could command the robot; the name of a certificate is expected"
        )
    if options.robot in options.commanders:
        raise DeviceError(
            f"{subject}: {options.robot!r} is both robot and commander; two different certificates are expected"
        )
    # Check the names that are used in ROS.
    for key in ("setpoint_topic", "measured_topic"):
        topic = getattr(options, key)
        if not isinstance(topic, str) or not rmw_zenoh.TOPIC.fullmatch(topic):
            raise DeviceError(
                f"{subject}: {key} is {topic!r}, not a valid key expression of a ROS topic; 'name/name' is expected"
            )
    if not options.connect:
        raise DeviceError(
            f"{subject}: connect is empty; the endpoint of the base robot or of a router is expected"
        )
    if not rmw_zenoh.NAME.fullmatch(options.node):
        raise DeviceError(
            f"{subject}: node is {options.node!r}; a ROS node name of letters, digits and underscores is expected"
        )
    for key in ("frame", "child_frame"):
        frame = getattr(options, key)
        if not frame or len(frame.encode()) > LONGEST_FRAME or "\0" in frame:
            raise DeviceError(
                f"{subject}: {key} is {frame[:40]!r}; a frame name of 1 to {LONGEST_FRAME} bytes is expected"
            )
    if not isinstance(options.domain, int) or not 0 <= options.domain <= 232:
        raise DeviceError(
            f"{subject}: domain is {options.domain!r}; a ROS domain from 0 to 232 is expected"
        )


def _check_endpoint(endpoint: Endpoint, options: LinkOptions, subject: str) -> None:
    """Check one endpoint. Raises DeviceError if the endpoint is not valid or not allowed.

    On a link without certificates, endpoints outside this machine are allowed only with `insecure`.
    """
    where, how = (
        f"{subject}: endpoint {endpoint.text}",
        "make certificates with `freeflyer certificates DIR`, then set certificates = 'DIR'",
    )
    if not endpoint.is_complete:
        raise DeviceError(
            f"{where} is incomplete; PROTOCOL/HOST:PORT is expected, such as tls/192.0.2.10:7447"
        )
    if endpoint.has_own_tls_settings:
        raise DeviceError(
            f"{where} has TLS settings that override the settings of the device; remove the part after '#'"
        )
    if options.certificates is not None and not endpoint.is_encrypted:
        raise DeviceError(
            f"{where} is not encrypted, but the device has certificates; tls/{endpoint.address} is expected"
        )
    if options.certificates is None and endpoint.is_encrypted:
        raise DeviceError(f"{where} is encrypted, but no certificates are named; {how}")
    if options.certificates is None and endpoint.is_every_interface:
        raise DeviceError(
            f"{where} listens on every interface of this machine, which requires certificates; {how}"
        )
    if not (options.certificates or options.insecure or endpoint.is_within_this_machine):
        raise DeviceError(
            f"{where} is not limited to this machine and is not encrypted, so any peer that reaches this endpoint could command the robot; {how} "
            f"and write tls/{endpoint.address} (or set insecure = true)"
        )


def options_from(name: str, raw: Mapping[str, Any], directory: Path) -> LinkOptions:
    """Read the options from `raw`. Raises DeviceError if they are not valid.

    `raw` is the table of the device `name` in the scenario. Paths are relative to `directory`, the
    directory of the scenario file.
    """
    defaults = LinkOptions()
    known_keys(name, raw, list(LinkOptions.__dataclass_fields__))
    folder = checked(name, raw, "certificates", str, "")
    insecure = raw.get("insecure", defaults.insecure)
    if not isinstance(insecure, bool):
        raise DeviceError(f"device {name}: insecure is {insecure!r}; true or false is expected")
    controller = checked(name, raw, "controller", str, defaults.controller)
    options = LinkOptions(
        connect=checked(name, raw, "connect", list, list(defaults.connect)),
        listen=checked(
            name, raw, "listen", list, ["tls/127.0.0.1:0"] if folder else list(defaults.listen)
        ),
        certificates=directory / Path(folder).expanduser() if folder else None,
        controller=controller,
        robot=checked(name, raw, "robot", str, name),
        commanders=checked(name, raw, "commanders", list, [controller]),
        insecure=insecure,
        domain=checked(name, raw, "domain", int, defaults.domain),
        **{
            key: checked(name, raw, key, str, getattr(defaults, key))
            for key in ("setpoint_topic", "measured_topic", "frame", "child_frame", "node")
        },
    )
    check(options, name)
    return options
