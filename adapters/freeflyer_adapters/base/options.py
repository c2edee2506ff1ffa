"""Options of a scenario's table `[devices.NAME]` of kind "zenoh_base".

Both ends of the link, the controller and the virtual base robot, use these options.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from freeflyer.foundation.keys import (
    LIST,
    SWITCH,
    TEXT,
    Key,
    Type,
    expecting,
    file_path,
    keys_of,
    read,
    setting,
    text_of,
)
from freeflyer.scenario.keys import COMPONENT
from freeflyer_adapters.base import rmw_zenoh
from freeflyer_adapters.base.certificates import AUTHORITY, NAME
from freeflyer_adapters.base.endpoint import Endpoint
from freeflyer_adapters.foundation.errors import DeviceError

LONGEST_FRAME = 200
"""Longest frame name [bytes]."""
_TOPIC = Type(text_of(rmw_zenoh.TOPIC), "{name} is {value}, not a valid key expression of a ROS topic; 'name/name' is expected")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class LinkOptions:
    """Options of the link, with endpoints in Zenoh's form.

    The virtual base robot listens on the endpoints of `connect`. Multicast and gossip of Zenoh are
    off, so only these endpoints are used.

    `certificates` is a folder. If it is given, each end authenticates with its own files in this
    folder. Without certificates, endpoints outside this machine are accepted only if the scenario
    sets `insecure`.
    """

    # fmt: off
    connect: Sequence[str] = setting(Key(LIST, "endpoints of the base robot or of a router", default=("tcp/127.0.0.1:7447",)))
    listen: Sequence[str] = setting(Key(LIST, "endpoints on which the controller listens; default: a free port of this machine"), ("tcp/127.0.0.1:0",))
    domain: int = setting(Key(expecting({"type": "integer", "minimum": 0, "maximum": 232}, "a ROS domain from 0 to 232 is expected"), "ROS domain", default=0))
    setpoint_topic: str = setting(Key(_TOPIC, "ROS topic of the set points", default="base_robot/setpoint"))
    measured_topic: str = setting(Key(_TOPIC, "ROS topic of the measurements", default="base_robot/measured"))
    frame: str = setting(Key(TEXT, "frame of the poses", default="inertial"))
    child_frame: str = setting(Key(TEXT, "frame of the base robot", default="base"))
    node: str = setting(Key(expecting(text_of(rmw_zenoh.NAME), "a ROS node name of letters, digits and underscores is expected"), "name of the controller's ROS node", default="freeflyer"))
    certificates: Path | None = setting(Key(file_path(), "folder made by `freeflyer certificates`, relative to the scenario. It has ca.pem, and a certificate and a key for each name"))
    controller: str = setting(Key(TEXT, "common name of the controller's certificate", default="controller"))
    robot: str = setting(Key(TEXT, "common name of the base robot's certificate; default: the name of the device"), "base_robot")
    commanders: Sequence[str] = setting(Key(LIST, "certificate names of the controllers that may command the base robot; default: `controller`"), ("controller",))
    insecure: bool = setting(Key(SWITCH, "whether endpoints outside this machine are accepted without certificates", default=False))
    # fmt: on


KEYS = keys_of(LinkOptions)


def check(options: LinkOptions, subject: str) -> None:
    """Check what the types of `KEYS` do not check. Raises DeviceError.

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
    if not options.connect:
        raise DeviceError(
            f"{subject}: connect is empty; the endpoint of the base robot or of a router is expected"
        )
    for key in ("frame", "child_frame"):
        frame = getattr(options, key)
        if not frame or len(frame.encode()) > LONGEST_FRAME or "\0" in frame:
            raise DeviceError(
                f"{subject}: {key} is {frame[:40]!r}; a frame name of 1 to {LONGEST_FRAME} bytes is expected"
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
    given = read(raw, KEYS, DeviceError, f"device {name}: ", others=COMPONENT)
    folder = given["certificates"]
    listen = ["tls/127.0.0.1:0"] if folder else LinkOptions().listen
    options = LinkOptions(
        **{
            **given,
            "certificates": directory / Path(folder).expanduser() if folder else None,
            "listen": raw.get("listen", listen),
            "robot": raw.get("robot", name),
            "commanders": raw.get("commanders", [given["controller"]]),
        }
    )
    check(options, name)
    return options
