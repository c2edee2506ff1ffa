"""Messages and signals of a DBC file, read by `cantools`, with every mistake as one sentence."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Mapping, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools

from freeflyer.foundation.bounded_file import content
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.units import factor
from freeflyer_adapters.device.device import DeviceError

LARGEST = 4 << 20
"""Bytes of a DBC. What whole cars have is below 3 MB."""
LARGEST_MESSAGE = 1785
"""Bytes, in any DBC: of a message in several frames by SAE J1939."""
MOST_BITS = 53
MOST_VALUES = 100_000
WORD = re.compile(r'"(?:\\"|[^"])*"|//[^\n]*|[A-Za-z0-9_.+-]+|\S')
ENCODING = "cp1252"
"""Of a DBC, as its tools write it."""
SPELLINGS = {"Nm": "N.m", "°": "deg", "°/s": "deg/s", "degrees": "deg"}
"""Units as DBCs spell them, and as FMI does."""


@dataclass(frozen=True, kw_only=True)
class Field:
    """One signal of a message: `factor` turns its own unit into the one asked for, in which `least` and `most` are what it holds."""

    name: str
    factor: float
    least: float
    most: float
    resolution: float


def field_of(message: Any, name: str, unit: str | None, path: Path) -> Field:
    """DeviceError if there is no such signal, it is no scaled integer, or its unit cannot be converted."""
    names: Mapping[str, Any] = {signal.name: signal for signal in message.signals}
    if name not in names:
        raise DeviceError(
            f"DBC {path}: message {message.name} has no signal {name!r}{did_you_mean(name, names)}"
        )
    signal = names[name]
    if signal.is_float:
        raise DeviceError(
            f"DBC {path}: signal {name} of {message.name} is a floating-point one; a scaled integer is expected"
        )
    if signal.is_multiplexer or signal.multiplexer_ids:
        raise DeviceError(
            f"DBC {path}: signal {name} of {message.name} is multiplexed; one that is always there is expected"
        )
    scale, offset = float(signal.scale), float(signal.offset)
    if not (scale and math.isfinite(scale) and math.isfinite(offset)):
        raise DeviceError(
            f"DBC {path}: signal {name} of {message.name} has the factor {scale:g} and the offset {offset:g}; finite numbers, and a factor "
            f"other than zero, are expected"
        )
    conversion = _conversion(signal, unit, path)
    if signal.start < 0:
        raise DeviceError(
            f"DBC {path}: signal {name} of {message.name} begins at bit {signal.start}; 0 or more is expected"
        )
    bits = int(signal.length)
    if bits > MOST_BITS:
        raise DeviceError(
            f"DBC {path}: signal {name} of {message.name} has {bits} bits; at most {MOST_BITS}, as a double has, are expected"
        )
    raw = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signal.is_signed else (0, (1 << bits) - 1)
    least, most = sorted(conversion * (scale * number + offset) for number in raw)
    if not (math.isfinite(least) and math.isfinite(most)):
        raise DeviceError(
            f"DBC {path}: signal {name} of {message.name} holds {least:g} to {most:g}; finite numbers are expected"
        )
    return Field(
        name=name, factor=conversion, least=least, most=most, resolution=abs(conversion * scale)
    )


def _conversion(signal: Any, unit: str | None, path: Path) -> float:
    if unit is None or not signal.unit:
        return 1.0
    try:
        return factor(SPELLINGS.get(signal.unit, signal.unit), unit)
    except ValueError as error:
        raise DeviceError(
            f"DBC {path}: signal {signal.name} is in {signal.unit!r}; {unit} is expected ({error})"
        ) from error


def occupied_bits(signal: Any) -> set[int]:
    """Bits of the frame, counted through its bytes from each byte's least significant one."""
    if signal.byte_order == "little_endian":
        return set(range(signal.start, signal.start + signal.length))
    byte, bit = divmod(int(signal.start), 8)
    from_top = 8 * byte + 7 - bit
    return {8 * (k // 8) + 7 - k % 8 for k in range(from_top, from_top + signal.length)}


@functools.lru_cache(maxsize=16)
def _parsed(text: str) -> Any:
    """Both ends of a link, and each of its frames, ask for the same file."""
    _check_sizes(text)
    return cantools.database.load_string(text, database_format="dbc", strict=True)


def only(message: Any, names: Set[str]) -> Any:
    """The same frame with these signals alone: what else a sender puts into it (a multiplexer's value that stands for nothing) can
    neither fail nor be needed.
    """
    return cantools.database.Message(
        frame_id=message.frame_id,
        name=message.name,
        length=message.length,
        signals=[signal for signal in message.signals if signal.name in names],
        is_extended_frame=message.is_extended_frame,
        is_fd=message.is_fd,
    )


def _check_sizes(text: str) -> None:
    """ValueError for a DBC with sizes that no message has: cantools makes lists of as many bits, and of as many multiplexer values."""
    words = [word for word in WORD.findall(text) if not word.startswith(('"', "//"))]
    sizes, values = [], 0
    for i, word in enumerate(words):
        if word == "BO_" and words[i + 3 : i + 4] == [":"]:  # BO_ identifier name : bytes
            sizes += words[i + 4 : i + 5]
        elif word == "|" and words[i + 2 : i + 3] == ["@"]:  # start | bits @
            sizes += [words[i - 1], *words[i + 1 : i + 2]]
        elif word == "SG_MUL_VAL_":  # SG_MUL_VAL_ identifier signal multiplexer first-last, ... ;
            listed = words[i + 4 : words.index(";", i) if ";" in words[i : i + 2000] else i + 2000]
            ends = [int(number[:12]) for number in re.findall(r"\d+", " ".join(listed))]
            values += sum(
                max(last - first, 0) + 1 for first, last in zip(ends[::2], ends[1::2], strict=False)
            )
    for size in sizes:
        if size.isdigit() and (len(size) > 6 or int(size) > 8 * LARGEST_MESSAGE):
            raise ValueError(
                f"a message or signal of {size[:20]} bytes or bits; at most {LARGEST_MESSAGE} bytes are expected"
            )
    if values > MOST_VALUES:
        raise ValueError(f"more than {MOST_VALUES} multiplexer values")


def load(path: Path) -> Any:
    """A cantools database; DeviceError with one sentence for a file that is none.

    Other formats that cantools knows by a file's name are not for us, nor is the cache of pickled databases that it can be told of.
    """
    if path.suffix.lower() != ".dbc":
        raise DeviceError(f"DBC {path}: a file whose name ends in .dbc is expected")
    try:
        return _parsed(content(path, LARGEST).decode(ENCODING))
    except OSError as error:
        raise DeviceError(f"DBC {path} cannot be read: {error.strerror or error}") from error
    except (
        Exception
    ) as error:  # cantools has several kinds for a malformed file, and passes on its parser's
        raise DeviceError(
            f"DBC {path} cannot be used: {' '.join(str(error).split())[:300]}"
        ) from error


def message_of(database: Any, name: str, path: Path) -> Any:
    names = [message.name for message in database.messages]
    if name not in names:
        raise DeviceError(f"DBC {path} has no message {name!r}{did_you_mean(name, names)}")
    return database.get_message_by_name(name)
