"""Messages and signals of a DBC file.

`cantools` reads the file. Every error is reported by a DeviceError.
"""

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
from freeflyer.foundation.errors import one_line
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.units import factor
from freeflyer_adapters.foundation.errors import DeviceError

LARGEST = 4 << 20
"""Largest DBC file [bytes]. The DBC files of complete cars are below 3 MB."""
LARGEST_MESSAGE = 1785
"""Largest message in a DBC [bytes]: a multi-packet message of SAE J1939."""
MOST_BITS = 53
"""Largest signal [bits]. This is the size of the significand of a double."""
MOST_VALUES = 100_000
"""Largest number of multiplexer values in a DBC."""
TOKEN = re.compile(r'"(?:\\"|[^"])*"|//[^\n]*|[A-Za-z0-9_.+-]+|\S')
ENCODING = "cp1252"
"""Encoding that DBC editors use for a DBC file."""
SPELLINGS = {"Nm": "N.m", "°": "deg", "°/s": "deg/s", "degrees": "deg"}
"""Units in DBC files, and their FMI names."""


@dataclass(frozen=True, kw_only=True)
class Field:
    """One signal of a message.

    `factor` converts a value from the unit of the signal to the requested unit. `least` and `most`
    are the limits of the range. `least`, `most` and `resolution` are in the requested unit.
    """

    name: str
    factor: float
    least: float
    most: float
    resolution: float


def field_of(message: Any, name: str, unit: str | None, path: Path) -> Field:
    """Return the signal `name` of a message, with its range in `unit`.

    If `unit` is None, the unit is not converted. `path`: DBC file in error messages. Raises
    DeviceError in these cases:

    - The signal is missing, is multiplexed, or is not a scaled integer.
    - The scale or the size of the signal is invalid.
    - The unit of the signal cannot be converted.
    """
    # The signal must exist, must be an integer, and must be in every frame.
    names: Mapping[str, Any] = {signal.name: signal for signal in message.signals}
    if name not in names:
        raise DeviceError(
            f"DBC {path}: message {message.name} has no signal {name!r}{did_you_mean(name, names)}"
        )
    signal = names[name]
    if signal.is_float:
        raise DeviceError(
            f"DBC {path}: signal {name} of {message.name} is a floating-point number; a scaled integer is expected"
        )
    if signal.is_multiplexer or signal.multiplexer_ids:
        raise DeviceError(
            f"DBC {path}: signal {name} of {message.name} is multiplexed; a signal in every frame is expected"
        )
    # cantools accepts infinite scales and negative start bits. Therefore check both here.
    scale, offset = float(signal.scale), float(signal.offset)
    if not (scale and math.isfinite(scale) and math.isfinite(offset)):
        raise DeviceError(
            f"DBC {path}: signal {name} of {message.name} has the factor {scale:g} and the offset {offset:g}; finite numbers are expected, "
            f"and the factor must not be zero"
        )
    conversion = _conversion(signal, unit, path)
    if signal.start < 0:
        raise DeviceError(
            f"DBC {path}: signal {name} of {message.name} starts at bit {signal.start}; 0 or more is expected"
        )
    # A double must represent every raw value exactly. Every value in SI units must be finite.
    bits = int(signal.length)
    if bits > MOST_BITS:
        raise DeviceError(
            f"DBC {path}: signal {name} of {message.name} has {bits} bits; at most {MOST_BITS} bits (precision of a double) are expected"
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
    """Return the numbers of the bits that a signal occupies in the frame.

    Bit 0 is the least significant bit of byte 0.
    """
    if signal.byte_order == "little_endian":
        return set(range(signal.start, signal.start + signal.length))
    byte, bit = divmod(int(signal.start), 8)
    from_top = 8 * byte + 7 - bit
    return {8 * (k // 8) + 7 - k % 8 for k in range(from_top, from_top + signal.length)}


@functools.lru_cache(maxsize=16)
def _parsed(text: str) -> Any:
    """Parse a DBC file.

    The result is cached, because both ends of a link load the same file for each frame type.
    """
    _check_sizes(text)
    return cantools.database.load_string(text, database_format="dbc", strict=True)


def only(message: Any, names: Set[str]) -> Any:
    """Return a copy of `message` that contains only the signals `names`.

    No other signal is decoded. Therefore an invalid value in another signal, for example in a
    multiplexer, cannot cause an error.
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
    """Raise ValueError if a message, a signal or a multiplexer range of a DBC is too large.

    cantools allocates memory for all bits and values that the file declares. Without this check, a
    small file could fill the memory.
    """
    tokens = [token for token in TOKEN.findall(text) if not token.startswith(('"', "//"))]
    sizes, values = [], 0
    for i, token in enumerate(tokens):
        if token == "BO_" and tokens[i + 3 : i + 4] == [":"]:  # BO_ identifier name : bytes
            sizes += tokens[i + 4 : i + 5]
        elif token == "|" and tokens[i + 2 : i + 3] == ["@"]:  # start | bits @
            sizes += [tokens[i - 1], *tokens[i + 1 : i + 2]]
        elif token == "SG_MUL_VAL_":  # SG_MUL_VAL_ identifier signal multiplexer first-last, ... ;
            end = tokens.index(";", i) if ";" in tokens[i : i + 2000] else i + 2000
            listed = tokens[i + 4 : end]
            ends = [int(number[:12]) for number in re.findall(r"\d+", " ".join(listed))]
            values += sum(
                max(last - first, 0) + 1 for first, last in zip(ends[::2], ends[1::2], strict=False)
            )
    for size in sizes:
        if size.isdigit() and (len(size) > 6 or int(size) > 8 * LARGEST_MESSAGE):
            raise ValueError(
                f"a message or signal has a size of {size[:20]} (bytes or bits); at most {LARGEST_MESSAGE} bytes are expected"
            )
    if values > MOST_VALUES:
        raise ValueError(f"more than {MOST_VALUES} multiplexer values")


def load(path: Path) -> Any:
    """Return the cantools database of a DBC file. Raises DeviceError if it is not a valid DBC.

    Other file formats of cantools are rejected. The cache of cantools (pickled databases) is not
    used.
    """
    if path.suffix.lower() != ".dbc":
        raise DeviceError(f"DBC {path}: a file whose name ends in .dbc is expected")
    try:
        return _parsed(content(path, LARGEST).decode(ENCODING))
    except OSError as error:
        raise DeviceError(f"DBC {path} cannot be read: {error.strerror or error}") from error
    except Exception as error:  # cantools and its parser raise several exception types
        raise DeviceError(f"DBC {path} cannot be used: {one_line(error, 300)}") from error


def message_of(database: Any, name: str, path: Path) -> Any:
    """Return the message `name` of a DBC. Raises DeviceError if it is missing."""
    names = [message.name for message in database.messages]
    if name not in names:
        raise DeviceError(f"DBC {path} has no message {name!r}{did_you_mean(name, names)}")
    return database.get_message_by_name(name)
