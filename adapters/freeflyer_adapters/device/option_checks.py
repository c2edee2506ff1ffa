"""Checks of the keys in the table of a device (`[devices.NAME]`) of a scenario.

`freeflyer_adapters.device.parameters` checks the numeric settings of a device.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from freeflyer.foundation.suggestions import unknown_keys
from freeflyer_adapters.foundation.errors import DeviceError

T = TypeVar("T")
KINDS = {str: "a text", int: "a whole number", dict: "a table", list: "a list"}


def known_keys(name: str, raw: Mapping[str, Any], keys: Sequence[str]) -> None:
    """Check the keys of `raw`. Raises DeviceError for a key that is not in `keys`."""
    for key, hint in unknown_keys(raw, keys, ("kind", "step_s", "parameters")):
        raise DeviceError(f"device {name}: unknown key {key!r}{hint}")


def checked(name: str, raw: Mapping[str, Any], key: str, kind: type[T], default: T) -> T:
    """Return the value of `key`, or `default` if the key is missing.

    Raises DeviceError if the type of the value is not `kind`.
    """
    value = raw.get(key, default)
    if not isinstance(value, kind) or isinstance(value, bool):
        raise DeviceError(f"device {name}: {key} is {value!r}; {KINDS[kind]} is expected")
    return value
