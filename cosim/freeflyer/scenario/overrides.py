"""Changes of a scenario's tables: `--set COMPONENT.PARAMETER=VALUE`, or a mapping in Python."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from freeflyer.foundation import toml_file
from freeflyer.foundation.errors import ScenarioError, one_line
from freeflyer.foundation.signal_name import split
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.units import quantity
from freeflyer.scenario import file_paths
from freeflyer.scenario.inheritance import Raw

Changes = Mapping[str, object] | Sequence[str]
"""Changes of a scenario: a mapping from COMPONENT.PARAMETER to a value, or texts as after `--set`.

A value is a number, a Boolean, a text such as "300 ms" or "matched", or a list or array of numbers.
"""


OF_RUN = ("stop_s", "exchange")
"""Targets without a component."""


def apply(raw: Raw, changes: Changes) -> None:
    """Apply changes to the tables `raw` of a scenario. Raises ScenarioError."""
    check_changes(changes)
    if not isinstance(changes, Mapping):
        for text in changes:
            override(raw, text)
        return
    for target, value in changes.items():
        assign(raw, target, plain(value, target), target)


def check_changes(changes: object) -> None:
    """Raise ScenarioError if `changes` is neither a mapping from texts nor a list of texts."""
    known = isinstance(changes, Mapping) or (
        isinstance(changes, Sequence) and not isinstance(changes, str)
    )
    if not known or not all(isinstance(item, str) for item in changes):  # type: ignore[attr-defined]
        raise ScenarioError(
            f"the changes are {changes!r}; a mapping {{'COMPONENT.PARAMETER': value}}, or a list of 'COMPONENT.PARAMETER=VALUE', is expected"
        )


def plain(value: object, target: str, *, texts: bool = False) -> Any:
    """Return a Python value as a value of TOML. Raises ScenarioError for another type.

    A text is parsed as the VALUE of `override`, unless `texts` is true.
    """
    if isinstance(value, str):
        return value if texts else parse_value(value)
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, bool | float) or (isinstance(value, int) and value in toml_file.INTEGERS):
        return value
    if isinstance(value, int):
        raise ScenarioError(
            f"{target} is an integer of more than 64 bits; a smaller number is expected"
        )
    if isinstance(value, list | tuple):
        return [plain(item, target, texts=texts) for item in value]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: plain(item, f"{target}: {key}", texts=texts) for key, item in value.items()}
    raise ScenarioError(
        f"{target} is {one_line(repr(value), 80)} of type {type(value).__name__}; a number, a Boolean, a text or a list is expected"
    )


def override(raw: Raw, text: str) -> None:
    """Apply `text`, which is COMPONENT.PARAMETER=VALUE, to the tables `raw` of a scenario.

    Raises ScenarioError.

    VALUE is a TOML value, an unquoted string, or a number with a unit ("300 ms").
    """
    target, equals, value = text.partition("=")
    assign(raw, target.strip(), parse_value(value.strip()) if equals else None, f"--set {text}")


def assign(raw: Raw, target: str, value: Any, where: str) -> None:
    """Set `target` in the tables `raw` to `value`. Raises ScenarioError.

    `target` is the text on the left of "=" in `--set`. If there is no "=", `value` is None, and
    ScenarioError is raised. `where` is the prefix of error messages.
    """
    component, parameter = split(target)
    components = _inner(raw, "components", where)
    if value is not None and component in ("devices", "facility", "record"):
        _assign_in_table(raw, where, target.split("."), value)
        return
    if value is not None and target in OF_RUN:
        raw[target] = value
        return
    if value is None or not component or not parameter:
        raise ScenarioError(
            f"{where}: COMPONENT.PARAMETER=VALUE is expected, for example base_controller.period=0.1{did_you_mean(target, OF_RUN)}"
        )
    if component == "robot" and component not in components:
        _assign_in_table(raw, where, [component, parameter], value)
        return
    if component not in components:
        raise ScenarioError(
            f"{where}: there is no component {component!r}{did_you_mean(component, components)}"
        )
    table = _inner(components, component, where)
    if parameter == "step_s":
        table["step_s"] = value
    else:
        _inner(table, "parameters", where)[parameter] = value


def _inner(table: Raw, key: str, where: str) -> Raw:
    found = table.setdefault(key, {})
    if not isinstance(found, dict):
        raise ScenarioError(f"{where}: {key!r} is not a table; its keys cannot be set")
    return found


def _assign_in_table(raw: Raw, where: str, keys: Sequence[str], value: Any) -> None:
    """Set a key of a nested table, for example devices.NAME.KEY or facility.KEY.

    `keys` are the parts between the dots, from the outermost table to the key. KEY may itself
    contain dots: it is then a key of a further nested table.
    """
    devices = raw.get("devices", {})
    if keys[0] == "devices" and (
        len(keys) < 3 or not isinstance(devices, dict) or keys[1] not in devices
    ):
        names = ", ".join(devices) if isinstance(devices, dict) and devices else "(none)"
        raise ScenarioError(f"{where}: devices.NAME.KEY=VALUE is expected, NAME one of: {names}")
    if not all(keys) or not 2 <= len(keys) <= toml_file.DEEPEST:
        raise ScenarioError(f"{where}: {keys[0]}.KEY=VALUE is expected")
    table = raw
    for key in keys[:-1]:
        table = _inner(table, key, where)
    table[keys[-1]] = value
    if keys[0] == "devices" and len(keys) == 3:
        table[keys[-1]] = file_paths.located(table, keys[-1], Path())


def parse_value(text: str) -> Any:
    """Return the value of an override.

    A TOML value is parsed. "NUMBER UNIT" becomes a table with the keys `value` and `unit`. Any
    other text is returned unchanged.
    """
    try:
        found = toml_file.parsed(f"value = {text}")
    except ValueError:
        found = {}
    return found["value"] if found.keys() == {"value"} else quantity(text) or text
