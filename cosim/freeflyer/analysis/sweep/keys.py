"""Keys of a sweep file. `file` reads them."""

from __future__ import annotations

from typing import Any, get_args

from freeflyer.analysis.sweep.designs import Method
from freeflyer.foundation.keys import (
    ANY,
    NUMBER,
    SWITCH,
    TEXT,
    Key,
    Keys,
    Schema,
    expecting,
    table_schema,
    whole,
)
from freeflyer.scenario.keys import TABLE, VALUE
from freeflyer.scenario.schema import document

_TEXTS: Schema = {"type": "array", "items": {"type": "string"}}
MOST_VALUES, MOST_RUNS = 10_000, 1_000_000
"""Largest number of values on an axis of a grid, and largest number of runs of a sweep."""
END = expecting({"type": "number"}, "a number is expected, and its unit in the key 'unit'")
UNIT = "the name of a unit is expected (a relative axis must have no unit)"

# fmt: off
OF_EVERY_AXIS: Keys = {
    "unit": Key(expecting({"type": "string"}, UNIT), "unit of the values, converted as in a scenario"),
    "relative": Key(SWITCH, "`true`: the values are factors. Each factor is multiplied by the value that the parameter has in the scenario with the changes of the case", default=False),
    "also": Key(expecting(_TEXTS, "a list of 'COMPONENT.PARAMETER' is expected"), "other parameters that get the same value or the same factor", default=[]),
    "not_in": Key(expecting(_TEXTS, "a list of names of cases is expected"), "cases that the axis does not change. These cases may set the parameter themselves", default=[]),
}
LEVELS: Keys = {"values": Key(ANY, "exactly these values. They can be numbers, vectors, names, `true` and `false`, or text with a unit such as `\"150 ms\"`. In a sample the values are equally likely", inner={"type": "array", "minItems": 1}), **OF_EVERY_AXIS}
_INTERVAL: Keys = {
    "logarithmic": Key(SWITCH, "`true`: consecutive values have equal ratios instead of equal distances", default=False),
    "multiple_of": Key(NUMBER, "values are rounded to exact decimal multiples of this number inside the interval. A base period must be a multiple of T_m, the period of the manipulator controller. Duplicate grid values are removed"),
    **OF_EVERY_AXIS,
}
GRID_INTERVAL: Keys = {
    "first": Key(END, "first value", required=True),
    "last": Key(END, "last value", required=True),
    "count": Key(expecting({"type": "integer", "minimum": 2, "maximum": MOST_VALUES}, f"at least 2 values are expected (use a list for a single value), and at most {MOST_VALUES}"), "number of values, including `first` and `last`", required=True),
    **_INTERVAL,
}
SAMPLED_INTERVAL: Keys = {
    "low": Key(END, "lower end of the interval", required=True),
    "high": Key(END, "upper end of the interval", required=True),
    **_INTERVAL,
}
AXIS = {**GRID_INTERVAL, **SAMPLED_INTERVAL, **LEVELS}
"""All keys of the table of an axis."""


def _axis(interval: Keys) -> Schema:
    own, levels = table_schema(interval), table_schema(LEVELS)
    return {
        "type": ["array", "object"],
        "minItems": 1,
        "properties": {**own["properties"], **levels["properties"]},
        "additionalProperties": True,
        "if": {"required": ["values"], "additionalProperties": True},
        "then": {"properties": dict.fromkeys(LEVELS, True), "additionalProperties": False},
        "else": {"properties": dict.fromkeys(interval, True), "additionalProperties": False, "required": own["required"]},
    }


def _axes(definition: str) -> Schema:
    """Return the keywords of a table of axes.

    TOML reads COMPONENT.PARAMETER without quotes as nested tables.
    """
    axis = {"$ref": f"#/$defs/{definition}"}
    nested = {"type": "object", "minProperties": 1, "propertyNames": {"not": {"enum": list(AXIS)}}}
    return {
        "patternProperties": {r"\.": axis},
        "additionalProperties": {"if": nested, "then": {"additionalProperties": axis}, "else": axis},
    }


SAMPLE: Keys = {
    "method": Key(ANY, "how the designs are drawn", default="latin_hypercube", inner={"enum": list(get_args(Method))}),
    "count": Key(whole(1, MOST_RUNS), "number of draws", required=True),
    "seed": Key(expecting({"type": "integer", "minimum": 0}, "a whole number of at least 0 is expected"), "the same seed gives the same designs", default=1),
    "parameters": Key(TABLE, "the axes of the sample", default={}, inner=_axes("sampled_axis")),
}
MAP: Keys = {
    "x": Key(ANY, "axis of the grid, with numbers", inner={"type": "string"}),
    "y": Key(ANY, "another axis of the grid, with numbers", inner={"type": "string"}),
    "predict": Key(SWITCH, "whether to draw the predicted stability boundary. `x` must then be the period of a controller", default=False),
}
_VALUES: Schema = {"additionalProperties": {"type": "object", "additionalProperties": VALUE}}
SWEEP: Keys = {
    "title": Key(TEXT, "title of the sweep"),
    "scenario": Key(expecting({"type": "string"}, "a shipped scenario or a .toml file beside the sweep is expected"), "a shipped scenario, or a path relative to this file", required=True),
    "set": Key(expecting(_TEXTS, "a list of 'COMPONENT.PARAMETER=VALUE' is expected"), "changes as with `--set`, for every run", default=[]),
    "cases": Key(TABLE, "targets and values of the case NAME. Each case is combined with every design", default={}, inner=_VALUES),
    "grid": Key(TABLE, "every combination of the values of these axes", default={}, inner=_axes("grid_axis")),
    "sample": Key(TABLE, "a random sample of designs", inner=table_schema(SAMPLE)),
    "vary": Key(TABLE, "changes one parameter at a time. The first design changes nothing", default={}, inner=_axes("grid_axis")),
    "designs": Key(TABLE, "targets and values of the design NAME. A parameter that a case sets is not changed by a design", default={}, inner=_VALUES),
    "map": Key(TABLE, "a figure over two axes of the grid", inner=table_schema(MAP)),
    "evaluation": Key(expecting({"type": "string", "pattern": ":"}, "'FILE.py:OBJECT' or 'MODULE:OBJECT' is expected"), "[evaluation](#results) that adds columns and a report"),
}
# fmt: on


def sweep_schema() -> dict[str, Any]:
    """Return the JSON Schema of a sweep file."""
    axes = {"grid_axis": _axis(GRID_INTERVAL), "sampled_axis": _axis(SAMPLED_INTERVAL)}
    return document("Sweep of freeflyer-cosim", SWEEP, **axes)
