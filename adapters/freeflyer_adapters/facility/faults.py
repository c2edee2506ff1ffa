"""Kinds of faults of a virtual facility's links and devices, and the scenario tables for them.

`[[facility.faults]]` schedules faults. `[facility.random_faults]` draws them with a seed.
`link_faults` applies them to packets; `can_faults` and `zenoh_faults` implement each transport.
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
    """A kind of fault.

    `takes`: the keys of `Fault` that apply to this kind. `whole_device`: it has no direction.
    """

    description: str
    takes: tuple[str, ...] = ()
    whole_device: bool = False


KINDS: Mapping[str, Kind] = {
    "loss": Kind(description="a packet is lost", takes=("probability",)),
    "delay": Kind(description="every packet is delayed by delay_s", takes=("delay_s",)),
    "jitter": Kind(description="every packet is delayed by a random time up to delay_s; the order is kept", takes=("delay_s",)),
    "duplication": Kind(description="a packet arrives twice", takes=("probability",)),
    "reordering": Kind(description="a packet arrives after its successor", takes=("probability",)),
    "flipped_bits": Kind(description="bits of a packet are inverted", takes=("probability", "bits")),
    "wrong_data_id": Kind(description="a packet has another sender's ID: another E2E data ID, another publisher's GID", takes=("probability",)),
    "stale_stamp": Kind(description="cycle number or time stamp does not change; the rest of the packet is correct"),
    "frozen_counter": Kind(description="E2E counter or sequence number does not change; the rest of the packet is correct"),
    "not_a_number": Kind(description="a packet's values are NaN", takes=("probability",)),
    "out_of_range": Kind(description="a packet's values are the largest that its format can represent", takes=("probability",)),
    "clock_jump": Kind(description="the sender's clock (cycle number, or time stamp) jumps by jump_s", takes=("jump_s",)),
    "cut": Kind(description="the link is interrupted for duration_s"),
    "bus_off": Kind(description="the device's CAN controller is in the state bus off: it neither sends nor receives", whole_device=True),
    "hung": Kind(description="the device's own controller hangs: it neither sends nor receives, and its last command continues to act", whole_device=True),
    "dead": Kind(description="the device has no power: the brakes close, and it sends nothing more in this session", whole_device=True),
    "device_fault": Kind(description="the device reports a fault of its own and brakes", whole_device=True),
}  # fmt: skip

MOST = 1000
"""Maximum number of random faults in a session."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault of one device.

    `begin_s` counts from the first activation of the device in a session. None: the fault is
    active from the start of the session.
    """

    kind: str
    device: str
    direction: Direction = "both"
    begin_s: float | None = None
    duration_s: float = math.inf
    """Rounded to whole cycles of the facility."""
    probability: float = 1.0
    """Probability for each packet."""
    delay_s: float = 0.01
    """Rounded up to whole cycles of the facility."""
    bits: int = 1
    jump_s: float = 1.0
    """May be negative."""

    def one_line(self) -> str:
        """Describe the fault in one line, for the output at the start of the facility."""
        where = "" if KINDS[self.kind].whole_device else f", {self.direction.replace('_', ' ')}"
        when = "always" if self.begin_s is None else f"{self.begin_s:.4g} s after activation"
        lasting = "" if math.isinf(self.duration_s) else f", for {self.duration_s:.4g} s"
        how = "".join(f", {key} {getattr(self, key):.4g}" for key in KINDS[self.kind].takes)
        return f"{self.kind.replace('_', ' ')} of {self.device}{where}: {when}{lasting}{how}"


@dataclass(frozen=True, kw_only=True)
class RandomFaults:
    """`count` faults that start within `within_s` after activation and last up to `longest_s`."""

    seed: int = 1
    count: int = 3
    within_s: float = 5.0
    longest_s: float = 0.3
    kinds: tuple[str, ...] = ()
    """Empty: all kinds that a device supports."""


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
    """Read `[[facility.faults]]`. Raises DeviceError for an invalid key or value."""
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
                f"{subject}: {key} does not apply to {kind}; it takes {', '.join((*takes, 'begin_s', 'duration_s'))}"
            )
    if "duration_s" in entry and "begin_s" not in entry:
        raise DeviceError(
            f"{subject}: duration_s counts from begin_s, which is missing; without both the fault is permanent"
        )
    if KINDS[kind].whole_device and direction != "both":
        raise DeviceError(
            f"{subject}: {kind} affects the whole device and has no direction; remove direction"
        )
    return Fault(**entry)


def read_random(raw: Any) -> RandomFaults:
    """Read `[facility.random_faults]`. Raises DeviceError for an invalid key or value."""
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
    """Draw random faults; the same seed gives the same faults.

    `devices` maps a device name to its supported kinds. Raises DeviceError if no device supports
    a chosen kind.
    """
    generator = random.Random(chosen.seed)
    offered = [
        (d, k) for d in sorted(devices) for k in devices[d] if not chosen.kinds or k in chosen.kinds
    ]
    if not offered:
        raise DeviceError(
            "[facility.random_faults] kinds: no device of this facility supports any of them"
        )
    drawn = []
    for _ in range(chosen.count):
        device, kind = generator.choice(offered)
        values: dict[str, Any] = {
            "probability": generator.choice((0.01, 0.05, 0.2, 0.5, 1.0)),
            "delay_s": generator.choice((0.001, 0.003, 0.01, 0.05)),
            "bits": generator.choice((1, 2, 3, 8, 64)),
            "jump_s": generator.choice((-1.0, -0.01, 0.01, 1.0, 3600.0)),
        }
        direction = generator.choice(DIRECTIONS)
        # Uniform on a logarithmic scale, so that short and long durations are equally frequent.
        duration = 1e-3 * (chosen.longest_s / 1e-3) ** generator.random()
        begin = generator.uniform(0.0, chosen.within_s)
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
    """Check devices and kinds. Raises DeviceError for an unknown device or unsupported kind."""
    for fault in faults:
        if fault.device not in devices:
            hint = (
                did_you_mean(fault.device, devices) or f"; one of {', '.join(devices)} is expected"
            )
            raise DeviceError(
                f"[[facility.faults]]: device {fault.device!r} is not simulated by this facility{hint}"
            )
        if fault.kind not in devices[fault.device]:
            known = ", ".join(devices[fault.device]) or "none"
            raise DeviceError(
                f"[[facility.faults]]: {fault.device} does not support the fault {fault.kind!r}; it supports {known}"
            )
