"""Read a sweep file (TOML) into a frozen `Sweep`.

A sweep runs one scenario many times. A target is the left side of `--set`, for example
COMPONENT.PARAMETER. An axis is a target with the values that it takes in the sweep. A design has
one value of each axis. A case is a list of targets with fixed values. Every design is run in every
case.
An error message contains the file, the key and the expected value.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from freeflyer.analysis.sweep.designs import (
    Axis,
    Designs,
    Interval,
    Levels,
    Method,
    NamedDesigns,
    OneAtATime,
    Sample,
    Target,
)
from freeflyer.foundation import toml_file
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.suggestions import did_you_mean, unknown_keys
from freeflyer.scenario import csv_parameters
from freeflyer.scenario.inheritance import Raw
from freeflyer.scenario.overrides import Changes, parse_value, plain
from freeflyer.scenario.scenario import texts

SHIPPED = Path(__file__).parents[2] / "paper" / "sweeps"
ONE_CASE = "scenario"
"""Name of the case in a sweep that has no table [cases]."""
AXIS = (
    "first",
    "last",
    "count",
    "low",
    "high",
    "values",
    "logarithmic",
    "multiple_of",
    "unit",
    "relative",
    "also",
    "not_in",
)
"""Keys of the table of an axis. An axis with an interval may have those from `logarithmic` on."""


@dataclass(frozen=True, kw_only=True)
class Map:
    """Axes of the stability map. `x` and `y` are the targets of two axes in [grid].

    If `predict` is true, the map also shows the stability boundary that is predicted from the
    linearised loop.
    """

    x: str
    y: str
    predict: bool


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Content of a sweep file.

    `settings` are arguments of `--set` that apply to every run. `cases` maps the name of each case
    to its targets and values.
    """

    name: str
    title: str
    path: Path
    scenario: str
    settings: tuple[str, ...]
    cases: Mapping[str, Mapping[str, Any]]
    designs: Designs | OneAtATime | NamedDesigns
    map: Map | None
    evaluation: str | None
    """FILE.py:OBJECT or MODULE:OBJECT, see `evaluation.Evaluation`."""


def shipped() -> list[str]:
    """Return the names of the shipped sweeps."""
    return sorted(path.stem for path in SHIPPED.glob("*.toml"))


def read(source: str | os.PathLike[str] | Mapping[str, Any], changes: Changes = ()) -> Sweep:
    """Read a shipped sweep by name, or a TOML file by path. Raises ScenarioError.

    `source` can also be the tables of such a file. `changes` are appended to the settings in the
    file.
    """
    settings = texts(changes)
    if isinstance(source, Mapping):
        raw = plain(source, "the sweep", texts=True)
        return _named(raw, Path("sweep.toml").absolute(), settings)
    path = _find(os.fspath(source))
    try:
        raw = toml_file.read(path)
    except OSError as error:
        raise ScenarioError(f"sweep {path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ScenarioError(f"sweep {path} is not valid TOML: {error}") from error
    return _named(raw, path, settings)


def _named(raw: Raw, path: Path, settings: Sequence[str]) -> Sweep:
    try:
        return _sweep(raw, path, settings)
    except ScenarioError as error:
        raise ScenarioError(f"sweep {path}: {error}") from error


def _find(name: str) -> Path:
    try:
        if name.endswith(".toml") and Path(name).is_file():
            return Path(name)
    except (OSError, ValueError):
        pass  # not a valid file name
    if name in shipped():
        return SHIPPED / f"{name}.toml"
    if name.endswith(".toml"):
        raise ScenarioError(f"sweep file {name} does not exist")
    raise ScenarioError(
        f"there is no sweep {name!r}: neither a shipped one nor a .toml file{did_you_mean(name, shipped())}"
    )


def _sweep(raw: Raw, path: Path, settings: Sequence[str]) -> Sweep:
    known = (
        "title",
        "scenario",
        "set",
        "cases",
        "grid",
        "sample",
        "vary",
        "designs",
        "map",
        "evaluation",
    )
    _known(raw, known, "the sweep")
    if not isinstance(raw.get("scenario"), str):
        raise ScenarioError(
            f"scenario is {raw.get('scenario')!r}; a shipped scenario or a .toml file beside the sweep is expected"
        )
    # Check the keys of the whole sweep. Then read the axes in [grid] and [sample].
    own = raw.get("set", [])
    if not isinstance(own, list) or not all(isinstance(text, str) for text in own):
        raise ScenarioError(f"set is {own!r}; a list of 'COMPONENT.PARAMETER=VALUE' is expected")
    title = raw.get("title", path.stem)
    if not isinstance(title, str):
        raise ScenarioError(f"title is {title!r}; a text is expected")
    grid, varied_alone = (
        tuple(
            _grid_axis(target, value, f"[{key}]")
            for target, value in _targets(_table(raw, key), f"[{key}]")
        )
        for key in ("grid", "vary")
    )
    if varied_alone and (grid or "sample" in raw or "map" in raw):
        raise ScenarioError(
            "[vary] changes one parameter at a time; remove [vary], or remove [grid], [sample] and [map]"
        )
    named = {
        name: _case("designs", name, table, path.parent)
        for name, table in _table(raw, "designs").items()
    }
    if named and (grid or varied_alone or "sample" in raw or "map" in raw):
        raise ScenarioError(
            "[designs.NAME] lists all designs; remove these tables, or remove [grid], [sample], [vary] and [map]"
        )
    designs: Designs | OneAtATime | NamedDesigns = (
        NamedDesigns(settings=named)
        if named
        else OneAtATime(axes=varied_alone)
        if varied_alone
        else Designs(grid=grid, sample=_sample(_table(raw, "sample")) if "sample" in raw else None)
    )
    if not designs.axes:
        raise ScenarioError(
            "the sweep varies no parameter; a [grid], a [sample], a [vary] with parameters, or [designs.NAME] is expected"
        )
    evaluation = raw.get("evaluation")
    if evaluation is not None and not (isinstance(evaluation, str) and ":" in evaluation):
        raise ScenarioError(
            f"evaluation is {evaluation!r}; 'FILE.py:OBJECT' or 'MODULE:OBJECT' is expected"
        )
    # A parameter may be set in only one place: an axis, a case, or `--set`.
    cases = {
        name: _case("cases", name, table, path.parent)
        for name, table in _table(raw, "cases").items()
    } or {ONE_CASE: {}}
    for axis in designs.axes:
        for name in axis.not_in:
            if name not in cases:
                raise ScenarioError(
                    f"{axis.target}: not_in has {name!r}, which is not a case{did_you_mean(name, cases)}"
                )
    varied = [target for axis in designs.axes for target in axis.targets]
    _reject_duplicates(designs.axes, cases)
    for text in settings:
        if any(
            target.name == text.partition("=")[0].strip() and target.elements is None
            for target in varied
        ):
            raise ScenarioError(
                f"{text}: {text.partition('=')[0].strip()} is varied by the sweep; remove this setting or the axis of the sweep"
            )
    return Sweep(
        name=path.stem,
        title=title,
        path=path,
        scenario=raw["scenario"],
        settings=(*own, *settings),
        cases=cases,
        designs=designs,
        map=_map(_table(raw, "map"), grid) if "map" in raw else None,
        evaluation=evaluation
        if evaluation is None or not evaluation.rpartition(":")[0].endswith(".py")
        else str((path.parent / evaluation).absolute()),
    )


def _case(kind: str, name: str, table: object, folder: Path) -> Mapping[str, Any]:
    """Return the targets and values of a case or of a named design.

    `kind` is the key of the table. The path of a CSV file is relative to `folder`.
    """
    if not isinstance(table, dict) or (kind == "cases" and not name.isidentifier()):
        raise ScenarioError(
            f"{kind}.{name}: a table of targets and values is expected; the name of a case may contain letters, digits and underscores"
        )
    found = dict(_targets(table, f"[{kind}.{name}]"))
    for target in found:
        if target.elements is not None:
            raise ScenarioError(
                f"[{kind}.{name}] {target}: a whole parameter is expected; elements are possible only in [grid], [sample] and [vary]"
            )
    values = {target.name: _value(value) for target, value in found.items()}
    return csv_parameters.expanded(values, folder, f"[{kind}.{name}] ")


def _grid_axis(target: Target, value: Any, table: str) -> Axis:
    where = f"{table} {target}"
    if not isinstance(value, dict) or "values" in value:
        return _levels(target, value, where)
    _known(value, ("first", "last", "count", *AXIS[6:]), where)
    count = value.get("count")
    if isinstance(count, bool) or not isinstance(count, int) or count < 2:
        raise ScenarioError(
            f"{where}: count is {count!r}; at least 2 values are expected (use a list for a single value)"
        )
    interval = _interval(value, "first", "last", where)
    return Axis(target=target, source=interval.spread(count), **_rest(value, where))


def _sample(raw: Raw) -> Sample:
    _known(raw, ("method", "count", "seed", "parameters"), "[sample]")
    method, count, seed = raw.get("method", "latin_hypercube"), raw.get("count"), raw.get("seed", 1)
    if method not in get_args(Method):
        known = get_args(Method)
        raise ScenarioError(
            f"[sample] method is {method!r}; one of {', '.join(known)} is expected{did_you_mean(str(method), known)}"
        )
    for key, number, least in (("count", count, 1), ("seed", seed, 0)):
        if isinstance(number, bool) or not isinstance(number, int) or number < least:
            raise ScenarioError(
                f"[sample] {key} is {number!r}; a whole number of at least {least} is expected"
            )
    parameters = _table(raw, "parameters")
    axes = tuple(
        _sampled_axis(target, value)
        for target, value in _targets(parameters, "[sample.parameters]")
    )
    if not axes:
        raise ScenarioError(
            "[sample] has no parameters; at least one target in [sample.parameters] is expected"
        )
    return Sample(method=method, count=count, seed=seed, axes=axes)  # type: ignore[arg-type]  # checked above


def _sampled_axis(target: Target, value: Any) -> Axis:
    where = f"[sample.parameters] {target}"
    if not isinstance(value, dict) or "values" in value:
        return _levels(target, value, where)
    _known(value, ("low", "high", *AXIS[6:]), where)
    return Axis(target=target, source=_interval(value, "low", "high", where), **_rest(value, where))


def _levels(target: Target, value: Any, where: str) -> Axis:
    table = value if isinstance(value, dict) else {"values": value}
    _known(table, ("values", "unit", "relative", "also", "not_in"), where)
    values = table["values"]
    if not isinstance(values, list) or not values:
        raise ScenarioError(
            f"{where} is {value!r}; a list with at least one value is expected, or a table with such a list"
        )
    return Axis(
        target=target,
        source=Levels(values=tuple(_value(item) for item in values)),
        **_rest(table, where, values),
    )


def _interval(value: Raw, low: str, high: str, where: str) -> Interval:
    for key in (low, high):
        if not _is_number(value.get(key)):
            raise ScenarioError(f"{where}: {key} is {value.get(key)!r}; a number is expected")
    if "multiple_of" in value and not _is_number(value["multiple_of"]):
        raise ScenarioError(
            f"{where}: multiple_of is {value['multiple_of']!r}; a number is expected"
        )
    if "multiple_of" in value and value.get("relative"):
        raise ScenarioError(
            f"{where}: multiple_of and relative are both set; remove one of these keys, because factors are not rounded"
        )
    try:
        return Interval(
            low=float(value[low]),
            high=float(value[high]),
            logarithmic=_switch(value, "logarithmic", where),
            multiple_of=value.get("multiple_of"),
        )
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {error}") from error


def _rest(value: Raw, where: str, values: Sequence[Any] = ()) -> dict[str, Any]:
    """Return the options that all axes have: unit, relative, also, not_in.

    `value` is the table of the axis. `values` is its list of values; it is empty for an interval.
    `where` is the prefix of error messages.
    """
    unit, relative = value.get("unit"), _switch(value, "relative", where)
    if unit is not None and (not isinstance(unit, str) or relative):
        raise ScenarioError(
            f"{where}: unit is {unit!r}; the name of a unit is expected (a relative axis must have no unit)"
        )
    if (unit is not None or relative) and not all(_is_number(item) for item in values):
        raise ScenarioError(
            f"{where} is {list(values)!r}; numbers are expected, because the axis has a unit or is relative"
        )
    also = value.get("also", [])
    if not isinstance(also, list) or not all(isinstance(text, str) for text in also):
        raise ScenarioError(
            f"{where}: also is {also!r}; a list of 'COMPONENT.PARAMETER' is expected"
        )
    not_in = value.get("not_in", [])
    if not isinstance(not_in, list) or not all(isinstance(text, str) for text in not_in):
        raise ScenarioError(f"{where}: not_in is {not_in!r}; a list of names of cases is expected")
    return {
        "unit": unit,
        "relative": relative,
        "also": tuple(Target.parse(text) for text in also),
        "not_in": tuple(not_in),
    }


def _map(raw: Raw, grid: Sequence[Axis]) -> Map:
    _known(raw, ("x", "y", "predict"), "[map]")
    numeric = {
        str(axis.target)
        for axis in grid
        if isinstance(axis.source, Levels) and all(map(_is_number, axis.source.values))
    }
    for key in ("x", "y"):
        if raw.get(key) not in numeric:
            raise ScenarioError(
                f"[map] {key} is {raw.get(key)!r}; a target of the grid with numbers is expected"
                f"{did_you_mean(str(raw.get(key)), sorted(numeric))}"
            )
    if raw["x"] == raw["y"]:
        raise ScenarioError(
            f"[map] x and y are both {raw['x']}; two targets of the grid are expected"
        )
    return Map(x=raw["x"], y=raw["y"], predict=_switch(raw, "predict", "[map]"))


def _reject_duplicates(axes: Sequence[Axis], cases: Mapping[str, Mapping[str, Any]]) -> None:
    pairs = [(axis, target) for axis in axes for target in axis.targets]
    for place, (axis, target) in enumerate(pairs):
        for _, other in pairs[:place]:
            if target.overlaps(other):
                raise ScenarioError(f"{target} is varied twice, also as {other}")
        for name, case in cases.items():
            if target.name in case and name not in axis.not_in:
                raise ScenarioError(
                    f"[cases.{name}] sets {target.name}, but the axis {target} varies this parameter"
                )


# Values of single keys


def _targets(table: Raw, where: str) -> Iterator[tuple[Target, Any]]:
    """Yield the targets and values of a table.

    A target COMPONENT.PARAMETER can be a quoted key. Without quotes, TOML reads it as a nested
    table.
    """
    for key, value in table.items():
        nested = (
            "." not in key
            and isinstance(value, dict)
            and value
            and not any(name in AXIS for name in value)
        )
        for name, item in (
            ((f"{key}.{inner}", item) for inner, item in value.items())
            if nested
            else ((key, value),)
        ):
            try:
                yield Target.parse(name), item
            except ScenarioError as error:
                raise ScenarioError(f"{where} {error}") from error


def _value(item: Any) -> Any:
    """Parse a text in the same way as a value of `--set`. Other values are returned unchanged."""
    return parse_value(item) if isinstance(item, str) else item


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _switch(raw: Raw, key: str, where: str) -> bool:
    value = raw.get(key, False)
    if not isinstance(value, bool):
        raise ScenarioError(f"{where}: {key} is {value!r}; true or false is expected")
    return value


def _table(raw: Raw, key: str) -> Raw:
    value = raw.get(key, {})
    if not isinstance(value, dict):
        raise ScenarioError(f"{key!r} is {value!r}; a table is expected")
    return value


def _known(raw: Raw, keys: Sequence[str], where: str) -> None:
    for key, hint in unknown_keys(raw, keys):
        raise ScenarioError(f"unknown key {key!r} in {where}{hint}")
