"""Mutations of the structure of a TOML document: keys, values, types and nesting."""

from __future__ import annotations

import copy
import datetime
import json
from collections.abc import Sequence
from random import Random
from typing import Any

Table = dict[str, Any]

TEXTS = (
    "", "=", "=robot", "=robot.", "=base_controller.period", "=.x", ".", "->", "<->", "a.b -> c.d", "a.b <-> c.d", "a -> b", "a.b -> c.d, ,",
    "nan", "0.1", "300 ms", "*", "?", "[", "../x", "/dev/zero", "CON", "a\nb", "a\"b\\c\0d", "ö\u202e\U0001f680", "x" * 3000, "%s%n", "{}",
    "facility", "multirate_passive", "multirate_passive.toml", "fuzz.toml", "beside.toml", "fifo.toml", "/dev/zero", ".toml",
)  # fmt: skip
NUMBERS = (
    0, 1, -1, 2, 3, 255, 10**9, 2**31, 2**53 + 1, 2**63 - 1, -(2**63), 2**63, 2**70, 10**400, 0.0, -0.0, 0.1, 1e-9, 1e-10, 1e-320, 5e-324,
    9e9, 8.999999999e9, 1e300, 1.7e308, float("inf"), float("-inf"), float("nan"), 0.001, 0.0010000001,
)  # fmt: skip
OTHERS = (
    True, False, [], {}, [[]], [{}], {"value": 1.0, "unit": "ms"}, {"value": 100, "unit": "furlong"}, {"value": [1, 2], "unit": "deg"},
    {"value": 1, "unit": ["ms"]}, {"value": "x", "unit": 3}, {"value": {}, "unit": ""}, {"value": 10**400, "unit": "s"}, {"unit": "s"},
    datetime.date(2026, 1, 1), datetime.time(1, 2, 3), datetime.datetime(1, 1, 1, tzinfo=datetime.UTC), [1, "a", True, [2]],
    {"kind": "python", "object": "os:abort", "step_s": 0.1}, {"kind": "fmu", "step_s": "=x"}, ["base_controller"], [1, 2], [2, 1], [0, 3],
)  # fmt: skip
KEYS = (
    "title", "paper", "stop_s", "expect", "robot", "record", "exchange", "components", "devices", "facility", "connections", "delayed", "limits",
    "errors", "observed_energy", "extends", "without", "every_s", "signals", "step_s", "kind", "parameters", "samples", "fmu", "value", "unit",
    "signal", "maximum", "minimum", "elements", "norm", "for_s", "cause", "base_position", "", "a.b", "x\ny", "ö", "free_flyer", "base_controller",
    "satellite", "dbc", "joints", "messages", "data_ids", "connect", "listen", "frame", "domain", "interface", "channel", "bus",
)  # fmt: skip


def places(value: Any) -> list[tuple[Any, Any]]:
    """Return every (container, key or index) below a value."""
    found: list[tuple[Any, Any]] = []
    stack = [value]
    while stack:
        inner = stack.pop()
        items = (
            inner.items()
            if isinstance(inner, dict)
            else enumerate(inner)
            if isinstance(inner, list)
            else ()
        )
        for key, item in items:
            found.append((inner, key))
            stack.append(item)
    return found


def unusual(rng: Random) -> Any:
    kind = rng.random()
    if kind < 0.05:
        return nested(rng)
    return copy.deepcopy(rng.choice(TEXTS if kind < 0.35 else NUMBERS if kind < 0.7 else OTHERS))


def nested(rng: Random) -> Any:
    value: Any = 1
    for _ in range(rng.choice((2, 5, 38, 39, 40, 41, 50))):
        value = [value] if rng.random() < 0.5 else {"a": value}
    return value


def mutate(rng: Random, table: Table, seeds: Sequence[Table]) -> None:
    every = places(table)
    if not every:
        table[rng.choice(KEYS)] = unusual(rng)
        return
    container, key = rng.choice(every)
    kind = rng.randrange(9)
    if kind <= 2:
        container[key] = unusual(rng)
    elif kind == 3:
        del container[key]
    elif kind == 4 and isinstance(container, dict):
        container[rng.choice(KEYS)] = container.pop(key)
    elif kind == 5 and isinstance(container, dict):
        container[rng.choice(KEYS)] = unusual(rng)
    elif kind == 6:
        container[key] = rng.choice(
            ([container[key]], {rng.choice(KEYS): container[key]}, [container[key], container[key]])
        )
    elif kind == 7:  # swap two parts
        other, there = rng.choice(every)
        container[key], other[there] = copy.deepcopy(other[there]), copy.deepcopy(container[key])
    else:  # a part of another document
        other, there = rng.choice(places(rng.choice(seeds)))
        container[key] = copy.deepcopy(other[there])


def emit(table: Table) -> str:
    """Return a document as TOML: one line per key, its value inline."""
    return "\n".join(
        f"{json.dumps(key, ensure_ascii=False)} = {inline(value)}" for key, value in table.items()
    )


def inline(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(
                f"{json.dumps(key, ensure_ascii=False)} = {inline(item)}"
                for key, item in value.items()
            )
            + "}"
        )
    if isinstance(value, list):
        return "[" + ", ".join(map(inline, value)) + "]"
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return repr(value)
