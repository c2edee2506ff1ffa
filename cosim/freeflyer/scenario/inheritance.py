"""Merge a scenario file into the scenario that the file names in its key `extends`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.signal_name import component_of, split_connection
from freeflyer.foundation.suggestions import did_you_mean

Raw = dict[str, Any]


def merged(base: Raw, change: Raw) -> Raw:
    """Return the merged tables of a file and of the scenario that the file extends.

    `change` has the tables of the file. `base` has the tables of the extended scenario.
    `change["without"]` is a list of component names. These components are left out, together with
    their devices, their connections and their signals in [roles].
    Raises ScenarioError if a component of this list does not exist.
    """
    change = dict(change)
    result = _without_components(base, change.pop("without", []))
    for key in ("connections", "delayed"):
        # A new connection replaces an old connection to the same input. Other connections remain.
        if isinstance(result.get(key), list):
            result[key] = [
                kept for text in result[key] for kept in _without_targets(text, _driven(change))
            ]
    for key, value in change.items():
        if (
            key in ("connections", "delayed")
            and isinstance(value, list)
            and isinstance(result.get(key), list)
        ):
            result[key] = [*result[key], *value]
            continue
        if isinstance(value, dict) and value.get("inherited_parameters") is False:
            # The file replaces all parameters of the component, for example with another FMU.
            value = {name: item for name, item in value.items() if name != "inherited_parameters"}
            kept = result.get(key, {}) if isinstance(result.get(key), dict) else {}
            result[key] = {name: item for name, item in kept.items() if name != "parameters"}
        if key == "devices" and isinstance(value, dict) and isinstance(result.get(key), dict):
            # If the file changes the kind of a device, no key of the old device is kept.
            kept = {
                name: {} if _other_kind(table, value.get(name)) else table
                for name, table in result[key].items()
            }
            result[key] = merged(kept, value)
            continue
        # A table { value = ..., unit = ... } or { first = ... } is the value of a parameter. It
        # replaces the old value. Other tables are merged.
        both_tables = (
            isinstance(value, dict)
            and isinstance(result.get(key), dict)
            and not {"value", "first", "csv"} & value.keys()
        )
        result[key] = merged(result[key], value) if both_tables else value
    return result


def _other_kind(table: object, change: object) -> bool:
    return (
        isinstance(table, dict)
        and isinstance(change, dict)
        and change.get("kind", table.get("kind")) != table.get("kind")
    )


def _without_components(base: Raw, names: Any) -> Raw:
    known = base.get("components", {})
    known = known if isinstance(known, dict) else {}
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ScenarioError(f"'without' is {names!r}; a list of component names is expected")
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
    if isinstance(base.get("roles"), dict):
        roles = {role: _signals_without(value, names) for role, value in base["roles"].items()}
        result["roles"] = {role: value for role, value in roles.items() if value}
    return result


def _signals_without(value: Any, names: Sequence[str]) -> Any:
    """Remove the signals of the components in `names` from the value of a role.

    `value` is one signal or a list of signals. Returns None if the one signal is removed.
    """
    if isinstance(value, list):
        return [signal for signal in value if component_of(str(signal)) not in names]
    return None if component_of(str(value)) in names else value


def _disconnected(text: str, names: Sequence[str]) -> list[str]:
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


def _joined(source: str, arrow: str, targets: Sequence[str]) -> list[str]:
    return [f"{source} {arrow} {', '.join(targets)}"] if targets else []
