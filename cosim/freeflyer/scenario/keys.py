"""Keys of a scenario file. `scenario` reads them, and `schema` writes their JSON Schema."""

from __future__ import annotations

from typing import Literal, get_args

from freeflyer.foundation.keys import (
    SECONDS,
    Key,
    Keys,
    Schema,
    Type,
    choice,
    expecting,
    key_schema,
    table_schema,
)
from freeflyer.master.graph import Exchange
from freeflyer.scenario.signal_roles import SEVERAL, SINGLE

Kind = Literal["position", "orientation"]
"""Kinds of errors."""

FACILITY = "freeflyer_adapters.facility.settings"
"""Module that reads the table [facility]."""
STRING = Type({"type": "string"}, "{name!r} is {value}; a string is expected")
TABLE = Type({"type": "object"}, "{name!r} is {value}; a table is expected")
ARRAY = Type({"type": "array"}, "{name!r} is {value}; an array is expected")
SIGNAL: Schema = {"type": "string", "pattern": r"^[^.]+\.[\s\S]"}
"""COMPONENT.VARIABLE"""
VALUE: Schema = {"$ref": "#/$defs/value"}
"""Value of a parameter, see `schema.VALUE`."""


def each(schema: Schema) -> Schema:
    """Return the keywords of a table whose keys are names that the user chooses."""
    return {"additionalProperties": schema}


# fmt: off
INHERITANCE: Keys = {
    "extends": Key(STRING, "the scenario to extend: its name, or a path relative to this file. Tables are merged. A connection replaces the inherited connection to the same input. Any other value replaces the inherited value. An [empty table or list](#extend-a-scenario) removes inherited entries"),
    "without": Key(ARRAY, "components to remove from the extended scenario. Everything that names them is removed, too: their devices and connections, and their entries in `limits`, `[errors]`, `[observed_energy]`, `[roles]`, `[record] signals` and `[[facility.faults]]`", inner={"items": {"type": "string"}}),
}
"""Keys of a file that the merged scenario does not have."""
COMPONENT_INHERITANCE: Keys = {
    "inherited_parameters": Key(Type({"type": "boolean", "enum": [False]}), "`false` leaves out the parameters of the extended scenario, for example if the file selects another FMU"),
}

RECORD: Keys = {
    "every_s": Key(SECONDS, "recording interval [s]", default=0.01),
    "signals": Key(expecting({"type": "array", "items": {"type": "string"}}, "a list of 'COMPONENT.VARIABLE' with wildcards * and ? is expected"),
                   "signals to record, as a list of `COMPONENT.VARIABLE` with wildcards. Signals of `[errors]` and `[observed_energy]` are always recorded", default=["*"]),
}
_KIND = "'kind' must be a name and 'parameters' a table"
COMPONENT: Keys = {
    "kind": Key(Type({"type": "string"}, _KIND), "[kind](#kinds-of-components) of the component. Each kind has further keys", default="fmu"),
    "step_s": Key(expecting({"anyOf": [{"type": "number"}, {"type": "string", "pattern": "^="}]}, "seconds, a time with a unit such as '20 ms', or '=PARAMETER' is expected", "s"),
                  "communication step [s], or `\"=PARAMETER\"` to use the value of a parameter of this component"),
    "samples": Key(expecting({"type": "boolean"}, "true or false is expected"), "whether the outputs are the values at the start of a step; see [order](#order-of-evaluation)"),
    "parameters": Key(Type({"type": "object"}, _KIND), "values of the component's parameters", default={}, inner=each(VALUE)),
}
_BOUND = "{value}; a number is expected, and a maximum must be greater than zero"
LIMIT: Keys = {
    "signal": Key(STRING, "the signal to check", required=True),
    "elements": Key(expecting({"type": "array", "items": {"type": "integer", "minimum": 1}, "minItems": 2, "maxItems": 2}, "[first, last], counted from 1, is expected"),
                    "`[first, last]` selects elements of the signal, counted from 1; without this key, all elements are checked"),
    "norm": Key(choice("maximum", "euclidean"), "the norm of the elements that is compared with `maximum`", default="maximum"),
    "maximum": Key(Type({"type": "number", "exclusiveMinimum": 0}, _BOUND), "upper bound of the absolute values. Give either `maximum` or `minimum`"),
    "minimum": Key(Type({"type": "number"}, _BOUND), "lower bound of the values"),
    "for_s": Key(SECONDS, "the run has diverged if the signal violates the bound for longer than this time [s]; default: 0"),
    "cause": Key(STRING, "the text that the report gives as the reason", default="limit passed"),
}
MEASURE: Keys = {
    "actual": Key(STRING, "the actual signal", required=True),
    "desired": Key(STRING, "the desired signal", required=True),
    "kind": Key(choice(*get_args(Kind)), "the error is a distance or an angle", required=True),
}
_OF_PLANT = "the plant's variable for the {}, if it is not named `{}`"
_OF_SEVERAL = {
    "orientations": "further variables of the plant that are quaternions, besides `base_orientation` and `end_effector_orientation`",
    "passivity_control": "Boolean parameters that enable passivity controllers, if they are not named `manipulator_passivity_control` and `base_passivity_control`",
    "preview": "Boolean parameters that select a later reference, if they are not named `preview`",
}
_ONE = Type(SIGNAL, "{name} is {value}; COMPONENT.VARIABLE is expected")
_SOME = Type({"anyOf": [SIGNAL, {"type": "array", "items": SIGNAL}]}, "{name} is {value}; a list of COMPONENT.VARIABLE is expected")
ROLES: Keys = {
    **{role: Key(_ONE, _OF_PLANT.format(role.replace("d_e", "d-e").replace("_", " "), role)) for role in SINGLE},
    **{role: Key(_SOME, _OF_SEVERAL[role]) for role in SEVERAL},
}
_PAIR: Schema = {"type": "array", "items": {"type": "string"}, "minItems": 2, "maxItems": 2}
ENERGY = Key(STRING, "signal of an observed energy")
_ERRORS: Schema = {
    "patternProperties": {f"({'|'.join(get_args(Kind))})$": {"anyOf": [_PAIR, table_schema(MEASURE)]}},
    "additionalProperties": table_schema(MEASURE),
}
SCENARIO: Keys = {
    "title": Key(STRING, "title of the report"),
    "paper": Key(STRING, "what the scenario corresponds to in the paper", default=""),
    "stop_s": Key(SECONDS, "end of the run [s]. It must be a multiple of the smallest step", required=True),
    "expect": Key(choice("completes", "diverges"), "outcome that gives exit code 0", default="completes"),
    "exchange": Key(choice(*get_args(Exchange)), "[exchange rule](peers.md#two-exchange-rules)", default="sequential"),
    "record": Key(TABLE, "the recorded signals", default={}, inner=table_schema(RECORD)),
    "robot": Key(TABLE, "parameters of the robot model. Each value is set on every component that has a parameter of this name. Plant and controllers then use the same robot model", default={}, inner=each(VALUE)),
    "components": Key(TABLE, "the component NAME. NAME consists of letters, digits and underscores", default={}, inner=each({"$ref": "#/$defs/component"})),
    "devices": Key(TABLE, "the device that replaces the component NAME when the scenario runs in `freeflyer hil`; see [the facility](facility.md)", default={}, inner=each({"$ref": "#/$defs/component"})),
    "facility": Key(TABLE, "settings of the [virtual facility](facility.md)", default={}, inner={"$ref": "#/$defs/facility"}),
    "connections": Key(ARRAY, "`\"COMPONENT.OUTPUT -> COMPONENT.INPUT, COMPONENT.INPUT\"`. `\"COMPONENT.TERMINAL <-> COMPONENT.TERMINAL\"` connects all matching members of two [terminals](fmus.md#terminals)", default=[], inner={"items": {"type": "string", "pattern": r"\.[\s\S]*->[\s\S]*\."}}),
    "delayed": Key(ARRAY, "connections that transfer the value that the source had before the present instant. A delayed connection does not affect the order of evaluation", default=[], inner={"items": {"type": "string", "pattern": r"\.[\s\S]*->[\s\S]*\."}}),
    "limits": Key(ARRAY, "bounds of signals. The run has diverged if a signal violates its bound", default=[], inner={"items": table_schema(LIMIT)}),
    "errors": Key(TABLE, "position and orientation errors to report in `summary.json`: `NAME_position = [actual, desired]` or `NAME_orientation = [actual, desired]`. With another name, also give the kind: `NAME = { actual = \"...\", desired = \"...\", kind = \"position\" }`", default={}, inner=_ERRORS),
    "roles": Key(TABLE, "signals of the base, the end-effector and the joints for `freeflyer predict`. The table is needed if the plant's variables have other names than those of `free_flyer`. Example: `base_position = \"chaser.r_b\"`", default={}, inner=table_schema(ROLES)),
    "observed_energy": Key(TABLE, "signals whose minimum is written to `summary.json`", default={}, inner=each(key_schema(ENERGY))),
}
# fmt: on
