"""Merge a scenario file into the scenario that the file names in its key `extends`."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.signal_name import component_of, split_connection
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.toml_file import as_written

Raw = dict[str, Any]
EMPTIED = ("connections", "delayed", "limits", "errors", "observed_energy", "roles", "devices")
"""Keys whose empty table or list removes all inherited entries.

Other empty tables change nothing: they are headers whose keys have been removed.
"""
VALUES = ("value", "first", "csv")
"""Keys of the tables { value = ..., unit = ... }, { first = [...] } and { csv = "FILE" }."""
SIGNALS = ("signal", "actual", "desired", "device")
"""Keys of the entries of limits, errors and faults whose values name a component."""
NEW = ("kind", "step_s", "fmu")
"""Keys of the table of a new component. Each new component has at least one of them."""


def merged(base: Raw, change: Raw) -> Raw:
    """Return the merged tables of a file and of the scenario that the file extends.

    `change` has the tables of the file. `base` has the tables of the extended scenario.
    `change["without"]` is a list of component names. These components are left out, together with
    all entries that name them.
    Raises ScenarioError if a component of this list does not exist, or if the file changes a
    component that does not exist.
    """
    change = dict(change)
    result = _without_components(base, change.pop("without", []))
    _check_components(result, change)
    for key in EMPTIED:
        if change.get(key) in ([], {}):
            result.pop(key, None)
    driven = _driven(change)
    for key in ("connections", "delayed"):
        # A new connection replaces an old connection to the same input. Other connections remain.
        if isinstance(result.get(key), list):
            kept = [kept for text in result[key] for kept in _without_targets(text, driven)]
            new = change.pop(key, [])
            result[key] = [*kept, *new] if isinstance(new, list) else new
    devices, changed = result.get("devices"), change.get("devices")
    if isinstance(devices, dict) and isinstance(changed, dict):
        # If the file changes the kind of a device, no key of the old device is kept.
        result["devices"] = {
            name: {} if _other_kind(table, changed.get(name)) else table
            for name, table in devices.items()
        }
    return _merged_tables(result, change)


def _merged_tables(base: Raw, change: Raw) -> Raw:
    result = dict(base)
    for key, value in change.items():
        if isinstance(value, dict) and value.get("inherited_parameters") is False:
            # The file replaces all parameters of the component, for example with another FMU.
            value = {name: item for name, item in value.items() if name != "inherited_parameters"}
            kept = result.get(key, {}) if isinstance(result.get(key), dict) else {}
            result[key] = {name: item for name, item in kept.items() if name != "parameters"}
        both_tables = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = (
            _merged_tables(result[key], value) if both_tables and not _is_value(value) else value
        )
    return result


def _is_value(table: Raw) -> bool:
    """Return whether a table is the value of a parameter, which replaces the inherited value.

    Other tables are merged.
    """
    return any(key in table and not isinstance(table[key], dict) for key in VALUES)


def _check_components(base: Raw, change: Raw) -> None:
    """Raise ScenarioError if a table in `change` changes a component that `base` does not have."""
    known, tables = (_table(raw, "components") for raw in (base, change))
    for name, table in tables.items():
        if name not in known and isinstance(table, dict) and not table.keys() & set(NEW):
            raise ScenarioError(
                f"components.{name}: the extended scenario has no such component, and a new component needs step_s{did_you_mean(name, known)}"
            )


def _table(raw: Raw, key: str) -> Raw:
    found = raw.get(key)
    return found if isinstance(found, dict) else {}


def _other_kind(table: object, change: object) -> bool:
    return (
        isinstance(table, dict)
        and isinstance(change, dict)
        and change.get("kind", table.get("kind")) != table.get("kind")
    )


def _without_components(base: Raw, names: Any) -> Raw:
    known = _table(base, "components")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ScenarioError(
            f"'without' is {as_written(names)}; a list of component names is expected"
        )
    for name in names:
        if name not in known:
            raise ScenarioError(
                f"without: there is no component {name!r}{did_you_mean(name, known)}"
            )
    result = dict(base)
    for key in ("components", "devices"):
        if isinstance(base.get(key), dict):
            result[key] = {name: table for name, table in base[key].items() if name not in names}
    for key in ("connections", "delayed"):
        if isinstance(base.get(key), list):
            result[key] = [kept for text in base[key] for kept in _disconnected(str(text), names)]
    # A role and the recorded signals are lists of independent signals. An error needs all of its
    # signals.
    for key in ("errors", "observed_energy"):
        if isinstance(base.get(key), dict):
            result[key] = {n: item for n, item in base[key].items() if not _names(item, names)}
    if isinstance(base.get("roles"), dict):
        roles = {role: _kept(value, names) for role, value in base["roles"].items()}
        result["roles"] = {role: value for role, value in roles.items() if value}
    if isinstance(base.get("limits"), list):
        result["limits"] = _kept(base["limits"], names)
    for key, inner in (("record", "signals"), ("facility", "faults")):
        if isinstance(_table(base, key).get(inner), list):
            result[key] = {**base[key], inner: _kept(base[key][inner], names)}
    return result


def _kept(value: Any, names: Collection[str]) -> Any:
    """Return the list `value` without the items that name a component in `names`.

    If `value` is not a list, return it, or None if it names such a component.
    """
    if isinstance(value, list):
        return [item for item in value if not _names(item, names)]
    return None if _names(value, names) else value


def _names(value: Any, names: Collection[str]) -> bool:
    """Return whether a signal, or an entry of a list or table, names a component in `names`."""
    if isinstance(value, dict):
        return any(_names(value.get(key), names) for key in SIGNALS)
    if isinstance(value, list):
        return any(_names(item, names) for item in value)
    return isinstance(value, str) and component_of(value) in names


def _disconnected(text: str, names: Collection[str]) -> list[str]:
    """Return the connection `text` without the targets in the components `names`.

    The result is a list with one connection. It is empty if no target remains, or if the source is
    in one of these components.
    """
    source, arrow, targets = split_connection(text)
    left = [target for target in targets if component_of(target) not in names]
    return _joined(source, arrow, left if component_of(source) not in names else [])


def _driven(raw: Raw) -> set[str]:
    """Return the inputs that the connections in the tables `raw` drive.

    Connections of terminals are not considered.
    """
    lists = (raw.get(key) for key in ("connections", "delayed"))
    texts = [str(text) for texts in lists if isinstance(texts, list) for text in texts]
    return {target for t in texts if "<->" not in t for target in split_connection(t)[2]}


def _without_targets(text: object, driven: set[str]) -> list[str]:
    """Return the connection `text` without the targets in `driven`.

    The result is a list with one connection. It is empty if no target remains.
    """
    if "<->" in str(text):
        return [str(text)]  # the inputs of a terminal are unknown until the FMUs are loaded
    source, arrow, targets = split_connection(str(text))
    return _joined(source, arrow, [target for target in targets if target not in driven])


def _joined(source: str, arrow: str, targets: Collection[str]) -> list[str]:
    return [f"{source} {arrow} {', '.join(targets)}"] if targets else []
