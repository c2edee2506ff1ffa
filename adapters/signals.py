"""Messages and signals of a DBC file, read by `cantools`, with every mistake as one sentence."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools

from adapters.device import DeviceError
from cosim.near import did_you_mean
from cosim.units import factor

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
        raise DeviceError(f"DBC {path}: message {message.name} has no signal {name!r}{did_you_mean(name, names)}")
    signal = names[name]
    if signal.is_float:
        raise DeviceError(f"DBC {path}: signal {name} of {message.name} is a floating-point one; a scaled integer is expected")
    if signal.is_multiplexer or signal.multiplexer_ids:
        raise DeviceError(f"DBC {path}: signal {name} of {message.name} is multiplexed; one that is always there is expected")
    conversion = _conversion(signal, unit, path)
    bits = int(signal.length)
    raw = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signal.is_signed else (0, (1 << bits) - 1)
    least, most = sorted(conversion * (float(signal.scale) * number + float(signal.offset)) for number in raw)
    return Field(name=name, factor=conversion, least=least, most=most, resolution=abs(conversion * float(signal.scale)))


def _conversion(signal: Any, unit: str | None, path: Path) -> float:
    if unit is None or not signal.unit:
        return 1.0
    try:
        return factor(SPELLINGS.get(signal.unit, signal.unit), unit)
    except ValueError as error:
        raise DeviceError(f"DBC {path}: signal {signal.name} is in {signal.unit!r}; {unit} is expected ({error})") from error


def occupied_bits(signal: Any) -> set[int]:
    """Bits of the frame, counted through its bytes from each byte's least significant one."""
    if signal.byte_order == "little_endian":
        return set(range(signal.start, signal.start + signal.length))
    byte, bit = divmod(int(signal.start), 8)
    from_top = 8 * byte + 7 - bit
    return {8 * (k // 8) + 7 - k % 8 for k in range(from_top, from_top + signal.length)}


@functools.lru_cache(maxsize=16)
def _loaded(path: Path, changed: int, size: int) -> Any:
    """Both ends of a link, and each of its frames, ask for the same file."""
    return cantools.database.load_file(path, strict=True)


def load(path: Path) -> Any:
    """A cantools database; DeviceError with one sentence for a file that is none."""
    try:
        status = path.stat()
        return _loaded(path, status.st_mtime_ns, status.st_size)
    except OSError as error:
        raise DeviceError(f"DBC {path} cannot be read: {error.strerror or error}") from error
    except Exception as error:  # cantools has several kinds for a malformed file, and passes on its parser's
        raise DeviceError(f"DBC {path} cannot be used: {' '.join(str(error).split())[:300]}") from error


def message_of(database: Any, name: str, path: Path) -> Any:
    names = [message.name for message in database.messages]
    if name not in names:
        raise DeviceError(f"DBC {path} has no message {name!r}{did_you_mean(name, names)}")
    return database.get_message_by_name(name)
