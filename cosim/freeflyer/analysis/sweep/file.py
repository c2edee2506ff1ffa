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
from freeflyer.analysis.sweep.keys import (
    AXIS,
    GRID_INTERVAL,
    LEVELS,
    MAP,
    MOST_RUNS,
    SAMPLE,
    SAMPLED_INTERVAL,
    SWEEP,
    UNIT,
)
from freeflyer.foundation import toml_file
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.file_name import text_of
from freeflyer.foundation.keys import Keys
from freeflyer.foundation.keys import read as read_keys
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.toml_file import as_written
from freeflyer.foundation.units import is_quantity
from freeflyer.scenario import csv_parameters
from freeflyer.scenario.inheritance import Raw
from freeflyer.scenario.overrides import Changes, parse_value, plain
from freeflyer.scenario.scenario import literal, texts

SHIPPED = Path(__file__).parents[2] / "paper" / "sweeps"
ONE_CASE = "scenario"
"""Name of the case in a sweep that has no table [cases]."""


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
    path = _find(text_of(source, "the sweep", ScenarioError))
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
    given = read_keys(raw, SWEEP, ScenarioError, where=" in the sweep")
    grid, varied_alone = (
        tuple(
            _axis(target, value, f"[{key}] {target}", GRID_INTERVAL)
            for target, value in _targets(given[key], f"[{key}]")
        )
        for key in ("grid", "vary")
    )
    if varied_alone and (grid or "sample" in raw or "map" in raw):
        raise ScenarioError(
            "[vary] changes one parameter at a time; remove [vary], or remove [grid], [sample] and [map]"
        )
    named = {
        name: _case("designs", name, table, path.parent) for name, table in given["designs"].items()
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
        else Designs(grid=grid, sample=_sample(given["sample"]) if "sample" in raw else None)
    )
    if not designs.axes:
        raise ScenarioError(
            "the sweep varies no parameter; a [grid], a [sample], a [vary] with parameters, or [designs.NAME] is expected"
        )
    runs = designs.count * max(len(given["cases"]), 1)
    if runs > MOST_RUNS:
        raise ScenarioError(
            f"the sweep has {runs} runs; at most {MOST_RUNS} are expected, so use fewer values or cases"
        )
    # A parameter may be set in only one place: an axis, a case, or `--set`.
    cases = {
        name: _case("cases", name, table, path.parent) for name, table in given["cases"].items()
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
    evaluation = given["evaluation"]
    return Sweep(
        name=path.stem,
        title=path.stem if given["title"] is None else given["title"],
        path=path,
        scenario=given["scenario"],
        settings=(*(_located(text, path.parent) for text in given["set"]), *settings),
        cases=cases,
        designs=designs,
        map=_map(given["map"], grid) if "map" in raw else None,
        evaluation=evaluation
        if evaluation is None or not evaluation.rpartition(":")[0].endswith(".py")
        else str((path.parent / evaluation).absolute()),
    )


def _located(text: str, folder: Path) -> str:
    """Return a text of the key `set`. The path of a CSV file in it is relative to `folder`."""
    target, _, value = text.partition("=")
    parsed = parse_value(value.strip())
    found = csv_parameters.located({target: parsed}, folder)[target]
    return text if found == parsed else f"{target}={literal(found)}"


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


def _sample(raw: Raw) -> Sample:
    given = read_keys(raw, SAMPLE, ScenarioError, subject="[sample] ", where=" in [sample]")
    method, known = given["method"], get_args(Method)
    if method not in known:
        raise ScenarioError(
            f"[sample] method is {as_written(method)}; one of {', '.join(known)} is expected{did_you_mean(str(method), known)}"
        )
    axes = tuple(
        _axis(target, value, f"[sample.parameters] {target}", SAMPLED_INTERVAL)
        for target, value in _targets(given["parameters"], "[sample.parameters]")
    )
    if not axes:
        raise ScenarioError(
            "[sample] has no parameters; at least one target in [sample.parameters] is expected"
        )
    return Sample(method=method, count=given["count"], seed=given["seed"], axes=axes)


def _axis(target: Target, value: Any, where: str, interval: Keys) -> Axis:
    """Return an axis. `value` is a list, or a table with a list or an interval.

    `interval` are the keys of a table with an interval. `where` is the prefix of error messages.
    """
    table = value if isinstance(value, dict) else {"values": value}
    keys = LEVELS if "values" in table else interval
    given = read_keys(table, keys, ScenarioError, subject=f"{where}: ", where=f" in {where}")
    values = given.get("values", [])
    if keys is LEVELS and (not isinstance(values, list) or not values):
        raise ScenarioError(
            f"{where} is {as_written(value)}; a list with at least one value is expected, or a table with such a list"
        )
    unit, relative = given["unit"], given["relative"]
    if unit is not None and relative:
        raise ScenarioError(f"{where}: unit is {unit!r}; {UNIT}")
    if (unit is not None or relative) and not all(_is_number(item) for item in values):
        raise ScenarioError(
            f"{where} is {as_written(values)}; numbers are expected, because the axis has a unit or is relative"
        )
    return Axis(
        target=target,
        source=Levels(values=tuple(map(_value, values))) if values else _interval(given, where),
        unit=unit,
        relative=relative,
        also=tuple(map(Target.parse, given["also"])),
        not_in=tuple(given["not_in"]),
    )


def _interval(given: Raw, where: str) -> Interval | Levels:
    """Return the interval of an axis. In a grid, return its values."""
    if given["multiple_of"] is not None and given["relative"]:
        raise ScenarioError(
            f"{where}: multiple_of and relative are both set; remove one of these keys, because factors are not rounded"
        )
    low, high = (given[key] for key in (("first", "last") if "first" in given else ("low", "high")))
    try:
        interval = Interval(
            low=float(low),
            high=float(high),
            logarithmic=given["logarithmic"],
            multiple_of=given["multiple_of"],
        )
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {error}") from error
    return interval.spread(given["count"]) if "count" in given else interval


def _map(raw: Raw, grid: Sequence[Axis]) -> Map:
    given = read_keys(raw, MAP, ScenarioError, subject="[map]: ", where=" in [map]")
    numeric = [
        str(axis.target)
        for axis in grid
        if isinstance(axis.source, Levels)
        and all(
            _is_number(value["value"] if is_quantity(value) else value)
            for value in axis.source.values
        )
    ]
    for key in ("x", "y"):
        if raw.get(key) not in numeric:
            raise ScenarioError(
                f"[map] {key} is {as_written(raw.get(key, ''))}; a target of the grid with numbers is expected"
                f"{did_you_mean(str(raw.get(key)), sorted(numeric))}"
            )
    if raw["x"] == raw["y"]:
        raise ScenarioError(
            f"[map] x and y are both {raw['x']}; two targets of the grid are expected"
        )
    return Map(x=raw["x"], y=raw["y"], predict=given["predict"])


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
