"""Faults of a virtual facility: faults of its links, and faults of its devices.

This module defines the kinds of faults, and reads the tables of a scenario that select faults.

The table `[[facility.faults]]` schedules faults. The table `[facility.random_faults]` draws random
faults with a seed. The module `link_faults` applies faults to packets (CAN frames or Zenoh
samples). It calls the module `can_faults` or `zenoh_faults` to change the content of a packet.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args

from freeflyer.foundation.suggestions import did_you_mean, unknown_keys
from freeflyer_adapters.foundation.errors import DeviceError

Direction = Literal["to_controller", "to_device", "both"]
DIRECTIONS: tuple[str, ...] = get_args(Direction)


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of fault.

    `takes`: the keys of `Fault` for this kind, besides the keys that apply to all kinds.
    `whole_device`: the fault affects the whole device and has no direction.
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
    "wrong_data_id": Kind(description="a packet has the ID of another sender (on CAN an E2E data ID, on Zenoh a publisher's GID)", takes=("probability",)),
    "stale_stamp": Kind(description="the cycle number or the time stamp does not change; the rest of the packet is correct"),
    "frozen_counter": Kind(description="the E2E counter or the sequence number does not change; the rest of the packet is correct"),
    "not_a_number": Kind(description="the values in a packet are NaN", takes=("probability",)),
    "out_of_range": Kind(description="the values in a packet are the largest values of the packet's format", takes=("probability",)),
    "clock_jump": Kind(description="the clock of the sender (cycle number or time stamp) jumps by jump_s", takes=("jump_s",)),
    "cut": Kind(description="the link is interrupted for duration_s"),
    "bus_off": Kind(description="the CAN controller of the device is in the state bus off: the device neither sends nor receives", whole_device=True),
    "hung": Kind(description="the controller in the device hangs: the device neither sends nor receives, and the last command continues to act", whole_device=True),
    "dead": Kind(description="the device has no power: the brakes engage, and the device sends nothing more in this session", whole_device=True),
    "device_fault": Kind(description="the device reports an internal fault and engages its brakes", whole_device=True),
}  # fmt: skip

MOST = 1000
"""Largest value of `count` in `[facility.random_faults]`."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault of one device.

    `begin_s` is measured from the first activation of the device in a session. If `begin_s` is
    None, the fault is active from the start of the session.
    """

    kind: str
    device: str
    direction: Direction = "both"
    begin_s: float | None = None
    duration_s: float = math.inf
    """The duration is rounded to whole cycles of the facility."""
    probability: float = 1.0
    """Probability that the fault affects a packet. It is applied to each packet separately."""
    delay_s: float = 0.01
    """The delay is rounded up to whole cycles of the facility."""
    bits: int = 1
    jump_s: float = 1.0
    """The jump may be negative."""

    def one_line(self) -> str:
        """Describe the fault in one line. The facility prints this line at its start."""
        where = "" if KINDS[self.kind].whole_device else f", {self.direction.replace('_', ' ')}"
        when = "always" if self.begin_s is None else f"{self.begin_s:.4g} s after activation"
        lasting = "" if math.isinf(self.duration_s) else f", for {self.duration_s:.4g} s"
        how = "".join(f", {key} {getattr(self, key):.4g}" for key in KINDS[self.kind].takes)
        return f"{self.kind.replace('_', ' ')} of {self.device}{where}: {when}{lasting}{how}"


@dataclass(frozen=True, kw_only=True)
class RandomFaults:
    """Settings of random faults.

    `count` faults are drawn. They start within `within_s` [s] after the activation, and each fault
    lasts at most `longest_s` [s].
    """

    seed: int = 1
    count: int = 3
    within_s: float = 5.0
    longest_s: float = 0.3
    kinds: tuple[str, ...] = ()
    """Kinds to draw from. Empty: all kinds that a device supports."""


ALLOWED = {
    "duration_s": "a number greater than zero",
    "begin_s": "a number, zero or more",
    "probability": "a number from 0 to 1",
    "delay_s": "a number of seconds from 0 to 10",
    "bits": "a whole number from 1 to 64",
    "jump_s": "a number of seconds from -1e6 to 1e6",
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
    for key, hint in unknown_keys(entry, known):
        raise DeviceError(f"{subject}: {key} is not known{hint}")
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
            f"{subject}: device is {entry.get('device')!r}; the name of a device in [devices] is expected"
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
                f"{subject}: {key} does not apply to {kind}; the keys of {kind} are {', '.join((*takes, 'begin_s', 'duration_s'))}"
            )
    if "duration_s" in entry and "begin_s" not in entry:
        raise DeviceError(
            f"{subject}: duration_s is measured from begin_s, but begin_s is missing; add begin_s, or remove duration_s for a permanent fault"
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
    for key, hint in unknown_keys(raw, known):
        raise DeviceError(f"[facility.random_faults] {key} is not known{hint}")
    for key, value in raw.items():
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
    """Draw random faults. The same seed gives the same faults.

    `devices` maps each device name to the kinds that the device supports. Raises DeviceError if no
    device supports any of the kinds in `chosen`.
    """
    generator = random.Random(chosen.seed)
    offered = [
        (d, k) for d in sorted(devices) for k in devices[d] if not chosen.kinds or k in chosen.kinds
    ]
    if not offered:
        raise DeviceError(
            "[facility.random_faults] kinds: no device of this facility supports any of these kinds"
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
    """Check that each fault names a known device, and a kind that this device supports.

    `devices` maps each device name to the kinds that the device supports. Raises DeviceError for an
    invalid fault.
    """
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
