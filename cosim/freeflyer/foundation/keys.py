"""Keys of the tables in TOML files. Each key is declared once, as a `Key`.

`read` checks a table with the declarations of its keys. `table_schema` returns the JSON Schema of
the table.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from copy import copy
from dataclasses import field, fields
from types import UnionType
from typing import Any, NamedTuple, TypeVar

from freeflyer.foundation.suggestions import unknown_keys
from freeflyer.foundation.toml_file import as_written
from freeflyer.foundation.units import in_unit

Schema = Mapping[str, Any]
"""JSON Schema, draft 2020-12. `fits` lists the keywords that a `Type` may have."""
F = TypeVar("F", bound=Callable[..., Any])


class Type(NamedTuple):
    """Type of a value: its JSON Schema, and the error message for a value that does not match.

    The message may contain {name} and {value}. If the type has a `unit`, the value may also have
    another unit, from which `read` converts it. If the value is the path of a file, `paths` has the
    endings of such a path; an empty ending means that every text is a path.
    """

    schema: Schema
    message: str = ""
    unit: str = ""
    paths: tuple[str, ...] = ()


class Key(NamedTuple):
    """One key of a table.

    `meaning` is its description in Markdown. A missing key has the value `default`. If `required`,
    a missing key is an error. `inner` has further keywords of the schema, for example the keys of
    an inner table. `read` does not check them, because the inner table has its own reader.
    """

    type: Type
    meaning: str
    default: Any = None
    required: bool = False
    inner: Schema = {}


Keys = Mapping[str, Key]


def choice(*names: str) -> Type:
    return expecting({"enum": list(names)}, f"{' or '.join(map(repr, names))} is expected")


def between(least: float, most: float, unit: str = "") -> Type:
    expected = f"a number from {least:g} to {most:g} is expected"
    return expecting({"type": "number", "minimum": least, "maximum": most}, expected, unit)


def expecting(schema: Schema, expected: str, unit: str = "") -> Type:
    """Return a type with the message "NAME is VALUE; EXPECTED"."""
    return Type(schema, f"{{name}} is {{value}}; {expected}", unit)


def file_path(*endings: str) -> Type:
    """Return the type of a text that is a path if it has one of `endings`, see `Type.paths`."""
    return TEXT._replace(paths=endings or ("",))


def whole(least: int, most: int) -> Type:
    expected = f"a whole number from {least} to {most} is expected"
    return expecting({"type": "integer", "minimum": least, "maximum": most}, expected)


def text_of(pattern: re.Pattern[str]) -> Schema:
    """Return the schema of a text that matches the whole pattern."""
    return {"type": "string", "pattern": rf"^(?:{pattern.pattern})$(?![\s\S])"}


ANY = Type({})
TEXT = expecting({"type": "string"}, "a text is expected")
NUMBER = expecting({"type": "number"}, "a number is expected")
WHOLE = expecting({"type": "integer"}, "a whole number is expected")
SWITCH = expecting({"type": "boolean"}, "true or false is expected")
LIST = expecting({"type": "array"}, "a list is expected")
TABLE = expecting({"type": "object"}, "a table is expected")
SECONDS = expecting(
    {"type": "number"},
    "a number of seconds is expected, or a time with a unit such as '20 ms'",
    "s",
)
QUANTITY: Schema = {
    "description": "a value with a unit",
    "anyOf": [
        {"type": "string", "pattern": r"^\s*\S+ +\S"},
        {"type": "object", "properties": {"value": {"type": ["number", "array"]}, "unit": {"type": "string"}}, "required": ["value", "unit"], "additionalProperties": False},
    ],
}  # fmt: skip
"""A value with a unit, which `read` converts to a number. It is in the `$defs` of each schema."""

TYPES: Mapping[str, type | UnionType] = {
    "string": str, "boolean": bool, "integer": int, "number": int | float, "array": list, "object": dict,
}  # fmt: skip
TESTS: Mapping[str, Callable[[Any, Any], bool]] = {
    "enum": lambda value, choices: value in choices,
    "minimum": lambda value, least: value >= least,
    "exclusiveMinimum": lambda value, bound: value > bound,
    "maximum": lambda value, most: value <= most,
    "exclusiveMaximum": lambda value, bound: value < bound,
    "minItems": lambda value, least: len(value) >= least,
    "maxItems": lambda value, most: len(value) <= most,
    "pattern": lambda value, pattern: re.search(pattern, value) is not None,
    "items": lambda value, schema: all(fits(item, schema) for item in value),
    "required": lambda value, names: value.keys() >= set(names),
    "properties": lambda value, inner: all(
        fits(value[name], schema) for name, schema in inner.items() if name in value
    ),
    "anyOf": lambda value, schemas: any(fits(value, schema) for schema in schemas),
}


def fits(value: Any, schema: Schema) -> bool:
    """Return whether a value matches a schema with the keywords `type` and those of `TESTS`.

    NaN does not match any schema with a type.
    """
    kind = TYPES.get(schema.get("type", ""), object)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind not in (bool, object)):
        return False
    return (kind is object or value == value) and all(
        test(value, schema[name]) for name, test in TESTS.items() if name in schema
    )


def read(
    raw: Mapping[str, Any],
    keys: Keys,
    fail: Callable[[str], Exception],
    prefix: str = "",
    *,
    subject: str = "",
    where: str = "",
    others: Collection[str] = (),
    unknown: str = "unknown key {name!r}",
) -> dict[str, Any]:
    """Return the values of all keys that a table may have.

    Raises the exception that `fail` returns for a message, if a key of the table `raw` is unknown
    or its value has the wrong type. Each message starts with `prefix`. `subject` follows in the
    message for a value. `unknown` and `where` are the message for an unknown key. `others` are
    further names to suggest.
    """
    for name, hint in unknown_keys(raw, keys, others):
        raise fail(f"{prefix}{unknown.format(name=name)}{where}{hint}")
    values = {name: raw[name] if name in raw else copy(key.default) for name, key in keys.items()}
    for name, key in keys.items():
        value = values[name]
        try:
            values[name] = in_unit(value, key.type.unit) if key.type.unit else value
        except ValueError as error:
            raise fail(f"{prefix}{subject}{name} is {as_written(value)}; {error}") from error
        if (name in raw or key.required) and not fits(values[name], key.type.schema):
            message = key.type.message.format(name=name, value=as_written(value))
            raise fail(f"{prefix}{subject}{message}")
    return values


def key_schema(key: Key) -> dict[str, Any]:
    """Return the JSON Schema of the value of a key. Links in its description become plain text."""
    described = {"description": re.sub(r"\[([^]]+)\]\([^)]+\)", r"\1", key.meaning)}
    default = {} if key.default is None else {"default": key.default}
    return {**type_schema(key), **described, **default}


def type_schema(key: Key) -> dict[str, Any]:
    """Return the JSON Schema of the value of a key, without its description."""
    is_open = {"additionalProperties": True} if key.type.schema.get("type") == "object" else {}
    own = {**key.type.schema, **is_open, **key.inner}
    return {"anyOf": [own, {"$ref": "#/$defs/quantity"}]} if key.type.unit else own


def table_schema(keys: Keys) -> dict[str, Any]:
    """Return the JSON Schema of a table that has no other keys than `keys`."""
    required = [name for name, key in keys.items() if key.required]
    return {
        "type": "object",
        "properties": {name: key_schema(key) for name, key in keys.items()},
        **({"required": required} if required else {}),
        "additionalProperties": False,
    }


def setting(key: Key, default: Any = None) -> Any:
    """Return a dataclass field that `key` sets. Its default is `default`, or that of the key."""
    value = key.default if default is None else default
    return field(default_factory=lambda: value, metadata={"key": key})


def keys_of(settings: type) -> Keys:
    """Return the keys that set the fields of a dataclass."""
    return {f.name: f.metadata["key"] for f in fields(settings) if "key" in f.metadata}


def declares(keys: Keys) -> Callable[[F], F]:
    """Declare the keys that only components of one kind have. This decorates the kind's factory."""

    def declaring(factory: F) -> F:
        factory.keys = keys  # type: ignore[attr-defined]
        return factory

    return declaring


def declared_by(factory: object) -> Keys | None:
    """Return the keys that `declares` has attached to a factory; None if there are none."""
    keys = getattr(factory, "keys", None)
    return keys if isinstance(keys, Mapping) else None
