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
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from freeflyer.foundation.keys import (
    ANY,
    Key,
    Schema,
    between,
    expecting,
    keys_of,
    setting,
    table_schema,
    whole,
)
from freeflyer.foundation.keys import read as read_keys
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.toml_file import as_written
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
    """A fault of one device."""

    # fmt: off
    kind: str = field(metadata={"key": Key(ANY, "kind of the fault: " + "; ".join(f"`{name}`: {kind.description}" for name, kind in KINDS.items()), inner={"enum": list(KINDS)})})
    device: str = field(metadata={"key": Key(expecting({"type": "string"}, "the name of a device in [devices] is expected"), "name of the device", required=True)})
    direction: Direction = setting(Key(expecting({"enum": list(DIRECTIONS)}, f"one of {', '.join(DIRECTIONS)} is expected"), "direction of the packets", default="both"))
    begin_s: float | None = setting(Key(expecting({"type": "number", "minimum": 0, "maximum": 1e9}, "a number, zero or more is expected", "s"), "start [s] after the first activation of the device in a session; without this key, the fault is active from the start"))
    duration_s: float = setting(Key(expecting({"type": "number", "minimum": 1e-9}, "a number greater than zero is expected", "s"), "duration [s], rounded to whole cycles of the facility"), math.inf)
    probability: float = setting(Key(between(0, 1), "probability that the fault affects a packet. It is applied to each packet separately", default=1.0))
    delay_s: float = setting(Key(expecting({"type": "number", "minimum": 0, "maximum": 10}, "a number of seconds from 0 to 10 is expected", "s"), "delay [s], rounded up to whole cycles of the facility", default=0.01))
    bits: int = setting(Key(whole(1, 64), "number of inverted bits", default=1))
    jump_s: float = setting(Key(expecting({"type": "number", "minimum": -1e6, "maximum": 1e6}, "a number of seconds from -1e6 to 1e6 is expected", "s"), "jump of the clock [s]; it may be negative", default=1.0))
    # fmt: on

    def one_line(self) -> str:
        """Describe the fault in one line. The facility prints this line at its start."""
        where = "" if KINDS[self.kind].whole_device else f", {self.direction.replace('_', ' ')}"
        when = "always" if self.begin_s is None else f"{self.begin_s:.4g} s after activation"
        lasting = "" if math.isinf(self.duration_s) else f", for {self.duration_s:.4g} s"
        how = "".join(f", {key} {getattr(self, key):.4g}" for key in KINDS[self.kind].takes)
        return f"{self.kind.replace('_', ' ')} of {self.device}{where}: {when}{lasting}{how}"


_SPAN = expecting({"type": "number", "minimum": 1e-9, "maximum": 1e9}, "a number of seconds greater than zero is expected", "s")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class RandomFaults:
    """Settings of random faults."""

    # fmt: off
    seed: int = setting(Key(whole(0, 1 << 62), "seed of the choice of the faults", default=1))
    count: int = setting(Key(whole(0, MOST), "number of faults", default=3))
    within_s: float = setting(Key(_SPAN, "the faults start within this time [s] after the activation", default=5.0))
    longest_s: float = setting(Key(_SPAN, "largest duration of a fault [s]", default=0.3))
    kinds: tuple[str, ...] = setting(Key(expecting({"type": "array", "items": {"enum": list(KINDS)}}, f"a list of {', '.join(KINDS)} is expected"), "kinds to draw from; default: all kinds that a device supports", default=()))
    # fmt: on


FAULT, RANDOM = keys_of(Fault), keys_of(RandomFaults)
FAULTS: Schema = {"type": "array", "items": {**table_schema(FAULT), "required": ["kind", "device"]}}
TIMES, QUANTITIES = ("begin_s", "duration_s"), ("probability", "delay_s", "bits", "jump_s")


def read(raw: Any) -> tuple[Fault, ...]:
    """Read `[[facility.faults]]`. Raises DeviceError for an invalid key or value."""
    if not isinstance(raw, list) or not all(isinstance(entry, Mapping) for entry in raw):
        raise DeviceError(
            f"[facility] faults is {as_written(raw)}; a list of tables, [[facility.faults]], is expected"
        )
    return tuple(
        _read_one(f"[[facility.faults]] number {i + 1}", entry) for i, entry in enumerate(raw)
    )


def _read_one(subject: str, entry: Mapping[str, Any]) -> Fault:
    given = read_keys(entry, FAULT, DeviceError, f"{subject}: ", unknown="{name} is not known")
    kind = given["kind"]
    if not isinstance(kind, str) or kind not in KINDS:
        hint = did_you_mean(str(kind), KINDS) or f"; one of {', '.join(KINDS)} is expected"
        raise DeviceError(
            f"{subject}: kind is {as_written(kind)}{hint}"
            if kind is not None
            else f"{subject}: kind is missing{hint}"
        )
    takes = KINDS[kind].takes
    for key in entry:
        if key in QUANTITIES and key not in takes:
            raise DeviceError(
                f"{subject}: {key} does not apply to {kind}; the keys of {kind} are {', '.join((*takes, *TIMES))}"
            )
    if "duration_s" in entry and "begin_s" not in entry:
        raise DeviceError(
            f"{subject}: duration_s is measured from begin_s, but begin_s is missing; add begin_s, or remove duration_s for a permanent fault"
        )
    if KINDS[kind].whole_device and given["direction"] != "both":
        raise DeviceError(
            f"{subject}: {kind} affects the whole device and has no direction; remove direction"
        )
    return Fault(**{key: given[key] for key in entry})


def read_random(raw: Any) -> RandomFaults:
    """Read `[facility.random_faults]`. Raises DeviceError for an invalid key or value."""
    if not isinstance(raw, Mapping):
        raise DeviceError(f"[facility] random_faults is {as_written(raw)}; a table is expected")
    prefix = "[facility.random_faults] "
    given = read_keys(raw, RANDOM, DeviceError, prefix, unknown="{name} is not known")
    return RandomFaults(**{**given, "kinds": tuple(given["kinds"])})


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
