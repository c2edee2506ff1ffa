"""What a scenario's `[devices.NAME]` of kind "zenoh_base" may say besides `parameters`; both ends of the link read it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adapters import rmw_zenoh
from adapters.device import DeviceError
from adapters.options import checked, known_keys

LONGEST_FRAME = 200
"""Bytes of a frame's name."""


@dataclass(frozen=True, kw_only=True)
class LinkOptions:
    """Endpoints as Zenoh writes them. Nothing is found by multicast or gossip: who is not named here is not met."""

    connect: Sequence[str] = ("tcp/127.0.0.1:7447",)
    listen: Sequence[str] = ("tcp/127.0.0.1:0",)
    domain: int = 0
    setpoint_topic: str = "base_robot/setpoint"
    measured_topic: str = "base_robot/measured"
    frame: str = "inertial"
    child_frame: str = "base"
    node: str = "freeflyer"


def check(options: LinkOptions, subject: str) -> None:
    """DeviceError for an endpoint or a topic that cannot be."""
    for key in ("connect", "listen"):
        endpoints = getattr(options, key)
        if isinstance(endpoints, str) or not all(isinstance(e, str) and "/" in e for e in endpoints):
            raise DeviceError(
                f"{subject}: {key} is {endpoints!r}; a list of endpoints such as 'tcp/127.0.0.1:7447' is expected"
            )
    if not options.listen:
        raise DeviceError(f"{subject}: listen is empty, and Zenoh would listen on every interface; name an endpoint")
    for key in ("setpoint_topic", "measured_topic"):
        topic = getattr(options, key)
        if not isinstance(topic, str) or not rmw_zenoh.TOPIC.fullmatch(topic):
            raise DeviceError(f"{subject}: {key} is {topic!r}, no valid key expression of a ROS topic; 'name/name' is expected")
    if not options.connect:
        raise DeviceError(
            f"{subject}: connect is empty, and nobody would be met; name the endpoint of the base robot or a router"
        )
    if not rmw_zenoh.NAME.fullmatch(options.node):
        raise DeviceError(
            f"{subject}: node is {options.node!r}; a ROS node name of letters, digits and underscores is expected"
        )
    for key in ("frame", "child_frame"):
        frame = getattr(options, key)
        if not frame or len(frame.encode()) > LONGEST_FRAME or "\0" in frame:
            raise DeviceError(f"{subject}: {key} is {frame[:40]!r}; a frame name of 1 to {LONGEST_FRAME} bytes is expected")
    if not isinstance(options.domain, int) or not 0 <= options.domain <= 232:
        raise DeviceError(f"{subject}: domain is {options.domain!r}; a ROS domain from 0 to 232 is expected")


def options_from(name: str, raw: Mapping[str, Any], directory: Path) -> LinkOptions:
    """The device's table as options; DeviceError for a key or value that is none."""
    defaults = LinkOptions()
    known_keys(name, raw, list(LinkOptions.__dataclass_fields__))
    options = LinkOptions(
        connect=checked(name, raw, "connect", list, list(defaults.connect)),
        listen=checked(name, raw, "listen", list, list(defaults.listen)),
        domain=checked(name, raw, "domain", int, defaults.domain),
        **{
            key: checked(name, raw, key, str, getattr(defaults, key))
            for key in ("setpoint_topic", "measured_topic", "frame", "child_frame", "node")
        },
    )
    check(options, name)
    return options
