"""JSON Schemas of scenario and sweep files: they have the keys that the readers accept."""

from __future__ import annotations

import copy
import json
import sys
import tomllib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.analysis.sweep import keys as sweep_keys
from freeflyer.analysis.sweep.designs import Interval, Levels
from freeflyer.foundation.errors import CosimError, ScenarioError
from freeflyer.foundation.keys import Key, Keys, fits, read, table_schema
from freeflyer.scenario import assemble, keys, scenario, schema
from freeflyer_adapters.facility import settings

sys.path.append(str(Path(__file__).parents[1] / "fuzz"))
import toml_mutation

SHIPPED = Path(scenario.__file__).parents[1] / "schema"
SCENARIO, SWEEP = (
    json.loads(json.dumps(made())) for made in (schema.scenario_schema, sweep_keys.sweep_schema)
)
SCENARIOS = sorted(scenario.SHIPPED.glob("*.toml"))
SWEEPS = sorted(sweep_file.SHIPPED.glob("*.toml"))


def errors(schema: dict[str, Any], tables: object, *, values: bool = True) -> list[str]:
    """Return the errors of a schema. Without `values`, values of parameters are not checked."""
    return [
        error.message
        for error in Draft202012Validator(schema).iter_errors(tables)
        if values or not {"parameters", "robot", "cases", "designs"} & set(error.absolute_path)
    ]


def parsed(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize(("name", "made"), [("scenario", SCENARIO), ("sweep", SWEEP)])
def test_the_schemas_in_the_package_are_up_to_date(name: str, made: dict[str, Any]) -> None:
    Draft202012Validator.check_schema(made)
    assert json.loads((SHIPPED / f"{name}.json").read_text(encoding="utf-8")) == made, (
        f"run: freeflyer check --schema {name} > cosim/freeflyer/schema/{name}.json"
    )


@pytest.mark.parametrize("path", [*SCENARIOS, *SWEEPS], ids=lambda path: path.stem)
def test_every_shipped_file_names_its_schema_and_matches_it(path: Path) -> None:
    directive, _, target = path.read_text(encoding="utf-8").partition("\n")[0].partition(" ")
    assert directive == "#:schema"
    assert (path.parent / target).resolve().parent == SHIPPED
    found = json.loads((path.parent / target).read_text(encoding="utf-8"))
    assert not errors(found, parsed(path))


@pytest.mark.parametrize("name", scenario.shipped())
def test_every_shipped_scenario_matches_the_schema_after_it_is_merged(name: str) -> None:
    assert not errors(SCENARIO, scenario.tables(name)[0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stop = 3", "'stop' was unexpected"),
        ("stop_s = 'long'", "'long' is not valid under any"),
        ("expect = 'glory'", "'glory' is not one of ['completes', 'diverges']"),
        ("[record]\nevery = 1", "'every' was unexpected"),
        ("[components.a]\nkind = 'fmu'\nfmuu = 'b'", "'fmuu' was unexpected"),
        ("[components.a]\nkind = 'fmu'\nblock = 'b'", "'block' was unexpected"),
        ("[components.a]\nkind = 'fmu'\nfmi = 1", "1 is not one of [2, 3]"),
        ("[components.a]\nparametres = {}", "'parametres' was unexpected"),
        ("[components.a]\nstep_s = 'fast'", "'fast' is not valid under any"),
        ("[devices.a]\nkind = 'can_arm'\nchanel = 'b'", "'chanel' was unexpected"),
        ("[devices.a]\nkind = 'can_arm'\nsignals = { cycl = 'b' }", "'cycl' was unexpected"),
        ("[devices.a]\nkind = 'zenoh_base'\ndomain = 233", "233 is greater than the maximum"),
        ("[facility]\nseed = 0", "0 is less than or equal to the minimum"),
        ("[[facility.faults]]\nkind = 'loss'\ndevice = 'a'\nbegin = 1", "'begin' was unexpected"),
        ("[[limits]]\nsignal = 'a.b'\nmaximum = 0", "0 is less than or equal to the minimum"),
        ("connections = ['a.b => c.d']", "does not match"),
        ("[errors]\nother = ['a.b', 'c.d']", "is not of type 'object'"),
        ("[roles]\nbase_positon = 'a.b'", "'base_positon' was unexpected"),
    ],
)
def test_a_mistake_in_a_scenario_is_found(text: str, message: str) -> None:
    found = errors(SCENARIO, tomllib.loads(text))
    assert any(message in one for one in found), found


@pytest.mark.parametrize(
    "text",
    [
        "[components.a]\nkind = 'of_another_package'\nown = 3",
        "[components.a]\nblock = 'free_flyer'",  # the extended scenario has the kind "twin"
        "[components.a]\nkind = 'twin'\nblock = 'free_flyer'\nstep_s = { value = 1, unit = 'ms' }",
        "[errors]\nbase_position = ['a.b', 'c.d']\nother = { actual = 'a.b', desired = 'c.d', kind = 'position' }",
        "[components.a.parameters]\nx = { first = [1] }\ny = '=b.c'\nz = { csv = 'f.csv' }\nw = { base = 'b' }",
    ],
)
def test_a_valid_scenario_is_accepted(text: str) -> None:
    assert not errors(SCENARIO, tomllib.loads(text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[gird]\nstop_s = [1]", "'gird' was unexpected"),
        ("[grid]\nstop_s = []", "should be non-empty"),
        ("[grid]\n'a.b' = { first = 1, last = 2 }", "'count' is a required property"),
        ("[grid]\n'a.b' = { first = 1, last = 2, count = 1 }", "1 is less than the minimum"),
        ("[grid]\n'a.b' = { values = [1], low = 2 }", "'low' was unexpected"),
        ("[grid]\na.b = { first = 1, last = 2, count = 2, multiple = 1 }", "'multiple' was"),
        ("[sample]\ncount = 0", "0 is less than the minimum"),
        ("[sample]\ncount = 1\nmethod = 'latin'", "'latin' is not one of"),
        ("[sample]\ncount = 1\nparameters.'a.b' = { low = 1 }", "'high' is a required property"),
        ("evaluation = 'file.py'", "does not match"),
    ],
)
def test_a_mistake_in_a_sweep_is_found(text: str, message: str) -> None:
    found = errors(SWEEP, tomllib.loads(f"scenario = 'a'\n{text}"))
    assert any(message in one for one in found), found


# Each table has the same keys in the schema and for the reader.

DEFINITIONS = SCENARIO["$defs"]
PLACES: dict[str, tuple[Keys, dict[str, Any]]] = {
    "scenario": ({**keys.INHERITANCE, **keys.SCENARIO}, SCENARIO),
    "record": (keys.RECORD, SCENARIO["properties"]["record"]),
    "limits": (keys.LIMIT, SCENARIO["properties"]["limits"]["items"]),
    "roles": (keys.ROLES, SCENARIO["properties"]["roles"]),
    "facility": (settings.KEYS, DEFINITIONS["facility"]),
    "sweep": (sweep_keys.SWEEP, SWEEP),
    "sample": (sweep_keys.SAMPLE, SWEEP["properties"]["sample"]),
    "map": (sweep_keys.MAP, SWEEP["properties"]["map"]),
    "axis": (sweep_keys.GRID_INTERVAL, SWEEP["$defs"]["grid_axis"]["else"]),
    "levels": (sweep_keys.LEVELS, SWEEP["$defs"]["grid_axis"]["then"]),
}
for number, (kind, of_kind) in enumerate(schema.of_kinds().items()):
    with_common = {**keys.COMPONENT, **keys.COMPONENT_INHERITANCE, **(of_kind or {})}
    PLACES[kind] = (with_common, DEFINITIONS["component"]["allOf"][number]["then"])


def differences(declared: Keys, found: dict[str, Any]) -> set[str]:
    """Return the keys that only the reader or only the schema has."""
    assert found["additionalProperties"] is False
    with pytest.raises(ScenarioError, match="unknown key"):
        read({"no such key": 1}, declared, ScenarioError)
    return declared.keys() ^ found["properties"].keys()


@pytest.mark.parametrize("place", PLACES)
def test_the_reader_and_the_schema_have_the_same_keys(place: str) -> None:
    declared, found = PLACES[place]
    assert not differences(declared, found)
    changed = {**found, "properties": {**found["properties"], "planted": {}}}
    assert differences(declared, changed) == {"planted"}
    assert differences({**declared, "planted": next(iter(declared.values()))}, found) == {"planted"}


def test_every_kind_of_this_distribution_declares_its_keys() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    points = project["project"]["entry-points"]["freeflyer.components"]
    assert {kind for kind, of_kind in schema.of_kinds().items() if of_kind} == points.keys()


def test_a_kind_that_declares_no_keys_may_have_any_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schema, "of_kinds", lambda: {"fmu": assemble.FMU, "other": None})
    made = schema.scenario_schema()
    assert errors(made, {"components": {"a": {"kind": "fmu", "own": 1}}})
    assert not errors(made, {"components": {"a": {"kind": "other", "own": 1}, "b": {"own": 1}}})


@pytest.mark.parametrize("place", PLACES)
def test_every_key_has_a_meaning_and_a_default_of_its_own_type(place: str) -> None:
    for name, key in PLACES[place][0].items():
        assert key.meaning, name
        assert key.default is None or place == "map" or matches(key), name


def matches(key: Key) -> bool:
    default = list(key.default) if isinstance(key.default, tuple) else key.default
    return fits(default, key.type.schema)


def mutated(files: list[Path], count: int) -> Iterator[dict[str, Any]]:
    tables = [parsed(path) for path in files]
    for number in range(count):
        rng = Random(number)
        table = copy.deepcopy(rng.choice(tables))
        for _ in range(rng.randrange(1, 4)):
            toml_mutation.mutate(rng, table, tables)
        yield table


def outcome(reader: Callable[[], object]) -> str | None:
    """Return None if a reader accepts its tables, otherwise the message."""
    try:
        reader()
    except CosimError as error:
        return str(error)
    return None


def test_the_schema_accepts_what_the_reader_of_scenarios_accepts(tmp_path: Path) -> None:
    """The schema also rejects tables with a key that the reader does not know."""
    accepted = rejected = 0
    for table in mutated([path for path in SCENARIOS if path.stem[0] == "_"], 600):
        message = outcome(
            partial(scenario.from_tables, copy.deepcopy(table), tmp_path / "mine.toml")
        )
        if message is None:
            accepted += 1
            # The factories of the kinds, which are not called here, reject other keys.
            found = errors(SCENARIO, table, values=False)
            assert not [error for error in found if "unexpected" not in error], table
        elif "unknown key" in message:
            rejected += 1
            assert errors(SCENARIO, table) or set(table) & set(keys.INHERITANCE), message
    assert min(accepted, rejected) > 20, (accepted, rejected)


def test_the_schema_accepts_what_the_reader_of_sweeps_accepts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The schema also rejects tables with a key that the reader does not know."""
    monkeypatch.setattr(Interval, "spread", lambda self, count: Levels(values=(self.low,)))
    accepted = rejected = 0
    for table in mutated([path for path in SWEEPS if path.stem != "battery"], 600):
        message = outcome(partial(sweep_file.read, table))
        if message is None:
            accepted += 1
            assert not errors(SWEEP, table, values=False), table
        elif "unknown key" in message:
            rejected += 1
            assert errors(SWEEP, table), message
    assert min(accepted, rejected) > 20, (accepted, rejected)


def test_values_fit_a_type_if_they_match_its_json_schema() -> None:
    """Except for NaN, and for 1.0 as an integer."""
    values = [None, True, 0, 1, -1, 2.5, "", "a.b", ":", "=a", [], [1], [1, 2], ["a.b"], {}, {"value": 1, "unit": "s"}]  # fmt: skip
    for declared, _ in PLACES.values():
        for name, key in declared.items():
            for value in values:
                expected = Draft202012Validator(dict(key.type.schema)).is_valid(value)
                assert fits(value, key.type.schema) == expected, (name, value)
    assert table_schema({})["properties"] == {}
