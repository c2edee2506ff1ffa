"""JSON Schema of scenario files, for editors. It is made from the keys that the readers check."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from freeflyer.foundation.keys import QUANTITY, Keys, Schema, table_schema, type_schema
from freeflyer.foundation.plugins import plugins
from freeflyer.scenario.file_paths import keys_of_kind
from freeflyer.scenario.keys import (
    COMPONENT,
    COMPONENT_INHERITANCE,
    FACILITY,
    INHERITANCE,
    SCENARIO,
)

VALUE: Schema = {
    "description": "a value; a value with a unit; the first elements of a vector; the columns of a CSV file; an enumeration value by its parts; or `\"=COMPONENT.PARAMETER\"`",
    "type": ["number", "boolean", "string", "array", "object"],
    "properties": {"value": {}, "unit": {"type": "string"}, "first": {"type": "array"}, "csv": {"type": "string"}},
    "additionalProperties": True,
}  # fmt: skip


def document(title: str, keys: Keys, **definitions: Schema) -> dict[str, Any]:
    """Return the JSON Schema of a file with `keys`."""
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title}
    return {
        **head,
        **table_schema(keys),
        "$defs": {"value": VALUE, "quantity": QUANTITY, **definitions},
    }


def of_kinds() -> dict[str, Keys | None]:
    """Return the keys of each kind of components. None: the kind may have any keys."""
    return {kind: keys_of_kind(kind) for kind in sorted(plugins("freeflyer.components"))}


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema of a scenario file, with the keys of the installed kinds."""
    facility: Keys = import_module(FACILITY).KEYS
    schema = document(
        "Scenario of freeflyer-cosim",
        {**INHERITANCE, **SCENARIO},
        component=_component(of_kinds()),
        facility=table_schema(facility),
    )
    del schema["required"]  # a file that extends another file needs no key
    return schema


def _component(kinds: Mapping[str, Keys | None]) -> Schema:
    """Return the JSON Schema of [components.NAME]. An unknown kind may have any keys.

    Without the key `kind`, the kind may be that of the extended scenario. Then the keys of all
    kinds are valid.
    """
    common = table_schema({**COMPONENT, **COMPONENT_INHERITANCE})["properties"]
    known = {kind: keys for kind, keys in kinds.items() if keys is not None}
    every = {name: key for keys in known.values() for name, key in keys.items()}
    meanings: dict[str, dict[str, list[str]]] = {name: {} for name in every}
    for kind, keys in known.items():
        for name, key in keys.items():
            meanings[name].setdefault(key.meaning, []).append(kind)
    described = {
        name: {"description": "; ".join(f"{text} ({', '.join(of)})" for text, of in texts.items())}
        for name, texts in meanings.items()
    }

    def closed(keys: Keys) -> Schema:
        types = {name: type_schema(key) for name, key in keys.items()}
        properties = {**dict.fromkeys(common, True), **types}
        return {"properties": properties, "additionalProperties": False}

    cases: list[tuple[Schema, Keys]] = [
        ({"properties": {"kind": {"const": kind}}, "required": ["kind"]}, keys)
        for kind, keys in known.items()
    ]
    if len(known) == len(kinds):
        cases.append(({"not": {"required": ["kind"]}}, every))
    return {
        "type": "object",
        "properties": {**described, **common},
        "additionalProperties": True,
        "allOf": [{"if": case, "then": closed(keys)} for case, keys in cases],
    }
