"""Faults of a virtual facility's links and devices: which there are, and what a scenario says of them.

`[[facility.faults]]` puts them on schedule, `[facility.random_faults]` draws them with a seed. What a fault does to the packets of a
link is in `link_faults`; what each transport makes of it, in `can_faults` and `zenoh_faults`.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args

from freeflyer.foundation.suggestions import did_you_mean
from freeflyer_adapters.device.device import DeviceError

Direction = Literal["to_controller", "to_device", "both"]
DIRECTIONS: tuple[str, ...] = get_args(Direction)


@dataclass(frozen=True, kw_only=True)
class Kind:
    """`takes`: the keys of a fault that mean something to this kind; `whole_device`: it has no direction."""

    description: str
    takes: tuple[str, ...] = ()
    whole_device: bool = False


KINDS: Mapping[str, Kind] = {
    "loss": Kind(description="a packet is lost", takes=("probability",)),
    "delay": Kind(description="every packet comes later by delay_s", takes=("delay_s",)),
    "jitter": Kind(description="every packet comes later by a random time up to delay_s; the order is kept", takes=("delay_s",)),
    "duplication": Kind(description="a packet comes twice", takes=("probability",)),
    "reordering": Kind(description="a packet comes after its successor", takes=("probability",)),
    "flipped_bits": Kind(description="bits of a packet are inverted", takes=("probability", "bits")),
    "wrong_data_id": Kind(description="a packet is somebody else's: another E2E data ID, another publisher's GID", takes=("probability",)),
    "stale_stamp": Kind(description="cycle number or time stamp stand still, and all else is well"),
    "frozen_counter": Kind(description="E2E counter or sequence number stands still, and all else is well"),
    "not_a_number": Kind(description="a packet's values are NaN", takes=("probability",)),
    "out_of_range": Kind(description="a packet's values are the largest that it can hold", takes=("probability",)),
    "clock_jump": Kind(description="the sender's clock (cycle number, or time stamp) jumps by jump_s", takes=("jump_s",)),
    "cut": Kind(description="the link is cut, and is back after duration_s"),
    "bus_off": Kind(description="the device's CAN controller is off the bus: it can neither send nor receive", whole_device=True),
    "hung": Kind(description="the device's own controller stands still: the link is there, what it commanded last acts on", whole_device=True),
    "dead": Kind(description="the device is without power: brakes, and never a packet again in this session", whole_device=True),
    "device_fault": Kind(description="the device itself says that it has failed, and brakes", whole_device=True),
}  # fmt: skip

MOST = 1000
"""Random faults of a session."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault of one device; `begin_s` counts from its first activation in a session, None: from the begin, activation included."""

    kind: str
    device: str
    direction: Direction = "both"
    begin_s: float | None = None
    duration_s: float = math.inf
    """Its end; whole cycles."""
    probability: float = 1.0
    """Of every packet."""
    delay_s: float = 0.01
    """Whole cycles of the facility, rounded up."""
    bits: int = 1
    jump_s: float = 1.0
    """May be negative."""

    def said(self) -> str:
        """In one line, as the facility says at its start."""
        where = "" if KINDS[self.kind].whole_device else f", {self.direction.replace('_', ' ')}"
        when = "always" if self.begin_s is None else f"{self.begin_s:.4g} s after activation"
        lasting = "" if math.isinf(self.duration_s) else f", for {self.duration_s:.4g} s"
        how = "".join(f", {key} {getattr(self, key):.4g}" for key in KINDS[self.kind].takes)
        return f"{self.kind.replace('_', ' ')} of {self.device}{where}: {when}{lasting}{how}"


@dataclass(frozen=True, kw_only=True)
class RandomFaults:
    """`count` faults that begin within `within_s` of activation and last up to `longest_s`."""

    seed: int = 1
    count: int = 3
    within_s: float = 5.0
    longest_s: float = 0.3
    kinds: tuple[str, ...] = ()
    """Empty: all that a device knows."""


ALLOWED = {
    "duration_s": "a number greater than zero",
    "begin_s": "a number, zero or more",
    "probability": "a number from 0 to 1",
    "delay_s": "a number of seconds from 0 to 10",
    "bits": "a whole number from 1 to 64",
    "jump_s": "a number of seconds, at most 1e6 either way",
}


def _fits(key: str, value: Any) -> bool:
    if (
        isinstance(value, bool)
        or not isinstance(value, int if key == "bits" else int | float)
        or math.isnan(value)
    ):
        return False
    least, most = {
        "duration_s": (1e-9, math.inf),
        "begin_s": (0.0, 1e9),
        "probability": (0.0, 1.0),
        "delay_s": (0.0, 10.0),
        "bits": (1, 64),
        "jump_s": (-1e6, 1e6),
    }[key]
    return bool(least <= value <= most)


def read(raw: Any) -> tuple[Fault, ...]:
    """`[[facility.faults]]`; DeviceError for a key or value that is none."""
    if not isinstance(raw, list) or not all(isinstance(entry, Mapping) for entry in raw):
        raise DeviceError(
            f"[facility] faults is {raw!r}; a list of tables, [[facility.faults]], is expected"
        )
    return tuple(
        _read_one(f"[[facility.faults]] number {i + 1}", entry) for i, entry in enumerate(raw)
    )


def _read_one(subject: str, entry: Mapping[str, Any]) -> Fault:
    known = [f.name for f in fields(Fault)]
    for key in entry:
        if key not in known:
            raise DeviceError(f"{subject}: {key} is not known{did_you_mean(key, known)}")
    kind = entry.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        hint = did_you_mean(str(kind), KINDS) or f"; one of {', '.join(KINDS)} is expected"
        raise DeviceError(
            f"{subject}: kind is {kind!r}{hint}"
            if kind is not None
            else f"{subject}: kind is missing{hint}"
        )
    if not isinstance(entry.get("device"), str):
        raise DeviceError(
            f"{subject}: device is {entry.get('device')!r}; the name of one of [devices] is expected"
        )
    direction = entry.get("direction", "both")
    if direction not in DIRECTIONS:
        raise DeviceError(
            f"{subject}: direction is {direction!r}; one of {', '.join(DIRECTIONS)} is expected"
        )
    takes = KINDS[kind].takes
    for key, value in entry.items():
        if key in ALLOWED and not _fits(key, value):
            raise DeviceError(f"{subject}: {key} is {value!r}; {ALLOWED[key]} is expected")
        if key in ALLOWED and key not in (*takes, "begin_s", "duration_s"):
            raise DeviceError(
                f"{subject}: {key} means nothing to {kind}; it takes {', '.join((*takes, 'begin_s', 'duration_s'))}"
            )
    if "duration_s" in entry and "begin_s" not in entry:
        raise DeviceError(
            f"{subject}: duration_s counts from begin_s, which is missing; without both the fault lasts for ever"
        )
    if KINDS[kind].whole_device and direction != "both":
        raise DeviceError(
            f"{subject}: {kind} is of the whole device and has no direction; leave it out"
        )
    return Fault(**entry)


def read_random(raw: Any) -> RandomFaults:
    """`[facility.random_faults]`; DeviceError for a key or value that is none."""
    if not isinstance(raw, Mapping):
        raise DeviceError(f"[facility] random_faults is {raw!r}; a table is expected")
    known = {f.name: f.default for f in fields(RandomFaults)}
    for key, value in raw.items():
        if key not in known:
            raise DeviceError(
                f"[facility.random_faults] {key} is not known{did_you_mean(key, known)}"
            )
        if key == "kinds":
            if not isinstance(value, list) or not all(
                isinstance(kind, str) and kind in KINDS for kind in value
            ):
                raise DeviceError(
                    f"[facility.random_faults] kinds is {value!r}; a list of {', '.join(KINDS)} is expected"
                )
            continue
        whole = isinstance(known[key], int)
        least, most = (0, MOST if key == "count" else 1 << 62) if whole else (1e-9, 1e9)
        if (
            isinstance(value, bool)
            or not isinstance(value, int if whole else int | float)
            or not least <= value <= most
        ):
            expected = (
                f"a whole number from 0 to {most}"
                if whole
                else "a number of seconds greater than zero"
            )
            raise DeviceError(
                f"[facility.random_faults] {key} is {value!r}; {expected} is expected"
            )
    return RandomFaults(**{**raw, "kinds": tuple(raw.get("kinds", ()))})


def draw(chosen: RandomFaults, devices: Mapping[str, Sequence[str]]) -> tuple[Fault, ...]:
    """Faults by lot: the same seed gives the same ones. `devices`: by name, the kinds that each knows."""
    lot = random.Random(chosen.seed)
    offered = [
        (d, k) for d in sorted(devices) for k in devices[d] if not chosen.kinds or k in chosen.kinds
    ]
    if not offered:
        raise DeviceError(
            "[facility.random_faults] kinds: no device of this facility knows one of them"
        )
    drawn = []
    for _ in range(chosen.count):
        device, kind = lot.choice(offered)
        values: dict[str, Any] = {
            "probability": lot.choice((0.01, 0.05, 0.2, 0.5, 1.0)),
            "delay_s": lot.choice((0.001, 0.003, 0.01, 0.05)),
            "bits": lot.choice((1, 2, 3, 8, 64)),
            "jump_s": lot.choice((-1.0, -0.01, 0.01, 1.0, 3600.0)),
        }
        direction = lot.choice(DIRECTIONS)
        # Short ones and long ones alike: even on a logarithmic scale.
        duration = 1e-3 * (chosen.longest_s / 1e-3) ** lot.random()
        begin = lot.uniform(0.0, chosen.within_s)
        drawn.append(
            Fault(
                kind=kind,
                device=device,
                direction="both" if KINDS[kind].whole_device else direction,  # type: ignore[arg-type]
                begin_s=begin,
                duration_s=duration,
                **{key: values[key] for key in KINDS[kind].takes},
            )
        )
    return tuple(drawn)


def check(faults: Sequence[Fault], devices: Mapping[str, Sequence[str]]) -> None:
    """Whether every fault's device is there and knows its kind; DeviceError if not."""
    for fault in faults:
        if fault.device not in devices:
            hint = (
                did_you_mean(fault.device, devices) or f"; one of {', '.join(devices)} is expected"
            )
            raise DeviceError(
                f"[[facility.faults]]: device {fault.device!r} is not played here{hint}"
            )
        if fault.kind not in devices[fault.device]:
            known = ", ".join(devices[fault.device]) or "none"
            raise DeviceError(
                f"[[facility.faults]]: {fault.device} has no fault {fault.kind!r}; it knows {known}"
            )
