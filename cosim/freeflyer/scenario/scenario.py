"""Read a scenario (TOML) into a frozen `Scenario`.

A scenario may extend another scenario. The key `extends` contains the path or the name of the other
scenario. Tables and connections are merged. Any other value replaces the inherited value.
The value of a parameter has one of these forms:
- a number, a list, a Boolean, or the name of an enumeration value
- `{ value = ..., unit = "deg" }`
- `{ first = [...] }`: the first elements; the other elements keep their start values
- `{ KEY = NAME, ... }`: the enumeration value whose name is KEY_NAME of all pairs, or NAME if all
  names are equal
- `{ csv = "FILE" }`: see `csv_parameters`
- "=COMPONENT.PARAMETER": a reference to another parameter
An error message contains the file, the key, the value and the expected value.
"""

from __future__ import annotations

import datetime
import json
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

from freeflyer.foundation import toml_file
from freeflyer.foundation.clock import nanoseconds, shown
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.file_name import text_of
from freeflyer.foundation.keys import fits, read, table_schema
from freeflyer.foundation.signal_name import component_of, split_connection
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.table import Shown, Table
from freeflyer.foundation.toml_file import as_written
from freeflyer.master.connection import Connection
from freeflyer.master.divergence import Limit
from freeflyer.master.graph import Exchange
from freeflyer.scenario import csv_parameters, file_paths, summary_file
from freeflyer.scenario.inheritance import Raw, merged
from freeflyer.scenario.keys import COMPONENT, ENERGY, LIMIT, MEASURE, RECORD, ROLES, SCENARIO, Kind
from freeflyer.scenario.overrides import Changes, apply, check_changes, plain
from freeflyer.scenario.signal_roles import SignalRoles

SHIPPED = Path(__file__).parent.parent / "paper" / "scenarios"
BARE_KEY = re.compile(r"[A-Za-z0-9_-]+", re.ASCII)
Step = int | str
"""A communication step [ns], or "=PARAMETER" for a parameter [s] of the same component."""


@dataclass(frozen=True, kw_only=True)
class ComponentSpec:
    """A component of a scenario.

    `kind` is the name of an entry point in the group freeflyer.components. `options` are the keys
    that only components of this kind have.
    """

    name: str
    kind: str
    step: Step
    parameters: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    samples: bool | None = None
    """True: the outputs are the values at the start of a step.

    False: the outputs are the values at the end of a step. None: the model description of the FMU
    decides between True and False.
    """


@dataclass(frozen=True, kw_only=True)
class Measure:
    """An error between an actual and a desired signal. Each signal is an output or a parameter.

    The error is the distance [m] between two positions (3,), or the angle [deg] between two
    orientations (4,).
    """

    actual: str
    desired: str
    kind: Kind

    @property
    def unit(self) -> str:
        return "m" if self.kind == "position" else "deg"


@dataclass(frozen=True, kw_only=True, repr=False)
class Scenario(Shown):
    """A checked scenario, as `load` returns it. It is immutable, and any thread may run it.

    `stop` and `record_every` are in ns. `changed` returns a scenario with other parameters.
    """

    name: str
    title: str
    paper: str
    directory: Path
    stop: int
    record_every: int
    record_signals: tuple[str, ...]
    """Patterns of the recorded signals COMPONENT.VARIABLE.

    The signals of the errors and of the observed energies are always recorded.
    """
    expect: Literal["completes", "diverges"]
    exchange: Exchange
    robot: Mapping[str, Any]
    components: tuple[ComponentSpec, ...]
    devices: tuple[ComponentSpec, ...]
    """Real or virtual hardware in the loop.

    Each device replaces the component of the same name.
    """
    facility: Mapping[str, Any]
    """Settings of the virtual facility. The virtual facility checks these keys."""
    connections: tuple[Connection, ...]
    limits: tuple[Limit, ...]
    errors: Mapping[str, Measure]
    observed_energy: Mapping[str, str]
    roles: SignalRoles
    source: str
    """The merged scenario as TOML, for the report."""
    keeps: object = field(default=None, compare=False)
    """Object that must live as long as the scenario: the folder of the FMUs of an SSP file."""
    changes: tuple[str, ...] = field(default=(), compare=False)
    """The changes of `load` and `changed`, as arguments of `--set`."""
    ssp: Mapping[str, Any] | None = field(default=None, compare=False)
    """The arguments `path` and `step` of `load_ssp`, if the scenario is from an SSP file."""

    def changed(self, changes: Changes) -> Scenario:
        """Return this scenario with other values of parameters, as `load(name, changes)`.

        Raises ScenarioError.
        """
        raw = toml_file.parsed(self.source)
        apply(raw, changes)
        found = from_tables(raw, self.directory / f"{self.name}.toml")
        return replace(
            found, keeps=self.keeps, ssp=self.ssp, changes=_latest((*self.changes, *texts(changes)))
        )

    @property
    def table(self) -> Table:
        """Components with their kinds and communication steps."""
        steps = {
            spec.name: spec.step if isinstance(spec.step, str) else f"{shown(spec.step)}"
            for spec in self.components
        }
        return Table(
            title=f"Scenario {self.name}: {self.title} ({shown(self.stop)}, {self.exchange} exchange, {len(self.connections)} connections)",
            header=("component", "kind", "step"),
            rows=[(spec.name, spec.kind, steps[spec.name]) for spec in self.components],
        )


def shipped() -> list[str]:
    """Return the names of the shipped scenarios, sorted."""
    return sorted(path.stem for path in SHIPPED.glob("*.toml") if not path.stem.startswith("_"))


def load(name: str | os.PathLike[str], changes: Changes = ()) -> Scenario:
    """Return a shipped scenario by name, a scenario file (.toml) by path, or that of a run.

    The scenario of a run has its changes, too; `name` is then the directory of the run.

    `changes` are new values of parameters: a mapping {"base_controller.period": "0.1 s"}, or a
    list of texts "base_controller.period=0.1 s". A number without a unit is in the unit of the
    parameter (SI; docs/fmu_variables.md). Raises ScenarioError.
    """
    text = text_of(name, "the scenario", ScenarioError)
    found = from_tables(*tables(text, changes))
    run = of_run(text)
    before = () if run is None else run["changes"]
    return replace(found, changes=_latest((*before, *texts(changes))))


def loaded(scenario: Scenario | str | os.PathLike[str], changes: Changes = ()) -> Scenario:
    """Return a scenario, or the scenario of a name or path, with changes. Raises ScenarioError."""
    if not isinstance(scenario, Scenario):
        return load(scenario, changes)
    return scenario.changed(changes) if changes else scenario


def tables(name: str, changes: Changes = (), beside: Path | None = None) -> tuple[Raw, Path]:
    """Return the tables of a scenario and the path of its file. Raises ScenarioError.

    The tables contain those of the extended scenarios, and the changes are applied. The tables
    are not checked. `name` and `beside` are the arguments of `find`, or `name` is the directory of
    a run.
    """
    run = of_run(name)
    if run is not None:
        if run.get("ssp") is not None:
            raise ScenarioError(f"{name} is a run of the SSP file {run['ssp']['path']}; `freeflyer run {name}` and `freeflyer.load_ssp` load such a system")  # fmt: skip
        try:
            raw = toml_file.parsed(run["scenario"])
        except ValueError as error:
            raise ScenarioError(f"the scenario in the summary.json of {name} is not valid TOML: {error}") from error  # fmt: skip
        path = Path(run["directory"], f"{run['name']}.toml")
    else:
        path = find(name, beside)
        raw = _read(path, ())
    apply(raw, changes)
    _expand(raw)
    return raw, path


def of_run(name: str) -> Mapping[str, Any] | None:
    """Return the description of a run, if `name` is the directory of a run.

    The name of a shipped scenario is not a directory here. Raises RecordError.
    """
    if name in shipped() or not name or not os.path.isdir(name):
        return None
    found: Mapping[str, Any] = summary_file.read(Path(name))["run"]
    return found


def from_tables(raw: Raw, path: Path) -> Scenario:
    """Convert the tables `raw` of the file `path` to a scenario. Raises ScenarioError."""
    _expand(raw)
    return _Reader(path).scenario(raw)


def find(name: str, beside: Path | None = None) -> Path:
    """Return the file of a scenario. Raises ScenarioError if there is no such file.

    `name` is a path or the name of a shipped scenario. If the folder `beside` is given, a path
    relative to this folder is tried first.
    """
    candidates = [Path(name)] if beside is None else [beside / name, Path(name)]
    if beside is not None or not name.startswith("_"):
        candidates.append(SHIPPED / f"{name}.toml")
    try:
        for path in candidates:
            if path.suffix == ".toml" and path.is_file():
                return path
    except (OSError, ValueError):
        pass  # not a valid file name
    if name.lower().endswith(".ssp"):
        raise ScenarioError(
            f"{name} is an SSP file; a scenario is expected here (`freeflyer run` accepts SSP files, too)"
        )
    if name.endswith(".toml"):
        exists = any(map(os.path.lexists, candidates))
        raise ScenarioError(
            f"scenario file {name} " + ("is not a regular file" if exists else "does not exist")
        )
    raise ScenarioError(
        f"there is no scenario {name!r}: neither a shipped one nor a .toml file{did_you_mean(name, shipped())}"
    )


def _read(path: Path, seen: tuple[Path, ...]) -> Raw:
    if path in seen:
        raise ScenarioError(
            f"scenario {path} extends itself through {' -> '.join(p.name for p in seen)}"
        )
    try:
        raw = toml_file.read(path)
    except OSError as error:
        raise ScenarioError(f"scenario {path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ScenarioError(f"scenario {path} is not valid TOML: {error}") from error
    for _, table in _parameter_tables(raw):
        table["parameters"] = csv_parameters.located(table["parameters"], path.parent)
    parent = raw.pop("extends", None)
    if parent is None:
        return raw
    if not isinstance(parent, str):
        raise ScenarioError(
            f"scenario {path}: 'extends' must be the name of a scenario, got {as_written(parent)}"
        )
    extended = find(parent, path.parent)
    base = _read(extended, (*seen, path))
    if extended.parent != path.parent:
        file_paths.locate(base, extended.parent)
    try:
        return merged(base, raw)
    except ScenarioError as error:
        raise ScenarioError(f"scenario {path}: {error}") from error


def _parameter_tables(raw: Raw) -> list[tuple[str, Raw]]:
    """Return the names and the tables of the components that have a table of parameters."""
    components = raw.get("components")
    return [
        (name, table)
        for name, table in (components.items() if isinstance(components, dict) else ())
        if isinstance(table, dict) and isinstance(table.get("parameters"), dict)
    ]


def _expand(raw: Raw) -> None:
    """Replace each `{ csv = "FILE" }` among the parameters of the components in the tables `raw`.

    A relative FILE is relative to the working directory. Raises ScenarioError.
    """
    for name, table in _parameter_tables(raw):
        table["parameters"] = csv_parameters.expanded(table["parameters"], Path(), f"{name}.")


class _Reader:
    """Converter of the raw tables of one file to dataclasses."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def fail(self, message: str) -> ScenarioError:
        return ScenarioError(f"scenario {self.path}: {message}")

    def scenario(self, raw: Raw) -> Scenario:
        given = read(raw, SCENARIO, self.fail, where=" in the scenario")
        record = read(given["record"], RECORD, self.fail, subject="[record] ", where=" in [record]")

        # The components are read first, because devices and roles refer to components.
        components = tuple(
            self.component(name, table) for name, table in given["components"].items()
        )
        if not components:
            raise self.fail("there are no components; at least one [components.NAME] is expected")
        devices = tuple(
            self.device(name, device, given["components"])
            for name, device in given["devices"].items()
        )

        # The remaining tables do not depend on each other.
        errors = {name: self.measure(name, pair) for name, pair in given["errors"].items()}
        energies = given["observed_energy"]
        return Scenario(
            name=self.path.stem,
            title=self.path.stem if given["title"] is None else given["title"],
            paper=given["paper"],
            directory=self.path.parent,
            stop=self.time(given["stop_s"], "stop_s"),
            record_every=self.time(record["every_s"], "[record] every_s"),
            record_signals=tuple(record["signals"]),
            expect=given["expect"],
            exchange=given["exchange"],
            robot=given["robot"],
            components=components,
            devices=devices,
            facility=given["facility"],
            connections=tuple(self.connections(given, "connections", False))
            + tuple(self.connections(given, "delayed", True)),
            limits=tuple(self.limit(item) for item in given["limits"]),
            errors=errors,
            observed_energy=read(energies, dict.fromkeys(energies, ENERGY), self.fail),
            roles=self.roles(given["roles"], given["components"]),
            source=to_toml(raw),
        )

    def component(self, name: str, raw: object) -> ComponentSpec:
        if not isinstance(raw, dict):
            raise self.fail(f"components.{name} is {as_written(raw)}; a table is expected")
        if not name.isidentifier():
            raise self.fail(
                f"component {name!r}: a name of letters, digits and underscores is expected"
            )
        if "step_s" not in raw:
            raise self.fail(
                f"component {name} has no step_s; its communication step in seconds is expected"
            )
        common = {key: value for key, value in raw.items() if key in COMPONENT}
        given = read(common, COMPONENT, self.fail, subject=f"component {name}: ")
        step = given["step_s"]
        return ComponentSpec(
            name=name,
            kind=given["kind"],
            step=step if isinstance(step, str) else self.time(step, f"component {name}: step_s"),
            parameters=given["parameters"],
            # The factory of the kind checks the options.
            options={key: value for key, value in raw.items() if key not in COMPONENT},
            samples=given["samples"],
        )

    def device(self, name: str, raw: object, components: Raw) -> ComponentSpec:
        """Return a device. By default, its step is the step of the replaced component."""
        if name not in components:
            raise self.fail(
                f"devices.{name}: there is no component {name!r} to replace{did_you_mean(name, components)}"
            )
        if not isinstance(raw, dict):
            raise self.fail(
                f"devices.{name} is {as_written(raw)}; a table with a 'kind' is expected"
            )
        if "kind" not in raw:
            raise self.fail(f"devices.{name} has no kind; the kind of the device is expected")
        return self.component(name, {"step_s": components[name]["step_s"], **raw})

    def connections(self, given: Raw, key: str, delayed: bool) -> Iterable[Connection]:
        for text in given[key]:
            if not isinstance(text, str):
                raise self.fail(f"{key}: {as_written(text)}; a string with '->' is expected")
            source, arrow, targets = split_connection(text)
            ends, of_terminals = [source, *targets], arrow == "<->"
            if not arrow or not all("." in end for end in ends) or (of_terminals and len(ends) > 2):
                expected = (
                    "COMPONENT.TERMINAL <-> COMPONENT.TERMINAL"
                    if of_terminals
                    else "COMPONENT.OUTPUT -> COMPONENT.INPUT, ..."
                )
                raise self.fail(f"{key}: {text!r}; {expected!r} is expected")
            for target in targets:
                yield Connection(
                    source=source, target=target, delayed=delayed, of_terminals=of_terminals
                )

    def limit(self, raw: object) -> Limit:
        """Return a limit. The table must contain either `maximum` or `minimum`."""
        if not isinstance(raw, dict):
            raise self.fail(f"limits: {as_written(raw)}; a table is expected")
        signal = raw.get("signal")
        one_bound = ("maximum" in raw) != ("minimum" in raw)
        if raw.keys() <= LIMIT.keys() and not (isinstance(signal, str) and one_bound):
            raise self.fail(
                f"limits: {as_written(raw)}; a 'signal' and either a 'maximum' or a 'minimum' are expected"
            )
        given = read(raw, LIMIT, self.fail, subject=f"limit on {signal}: ", where=" in [[limits]]")
        if "minimum" in raw and "norm" in raw:
            raise self.fail(f"limit on {signal}: 'norm' applies to a 'maximum'; remove it here")
        elements = given["elements"]
        if elements is not None and elements[0] > elements[1]:
            raise self.fail(
                f"limit on {signal}: elements is {elements!r}; [first, last], counted from 1, is expected"
            )
        return Limit(
            signal=given["signal"],
            bound=float(raw["minimum" if "minimum" in raw else "maximum"]),
            is_minimum="minimum" in raw,
            cause=given["cause"],
            # Without `elements` the limit applies to all elements of the signal.
            elements=None if elements is None else (elements[0], elements[1]),
            euclidean=given["norm"] == "euclidean",
            lasting=self.time(given["for_s"], f"limit on {signal}: for_s") if "for_s" in raw else 0,
        )

    def measure(self, name: str, given: object) -> Measure:
        """Return the error `name` that the scenario declares as a list or as a table.

        The list is [actual, desired]. With a list, `name` must end in "position" or "orientation",
        because this end is the kind. The table has the keys `actual`, `desired` and `kind`.
        """
        table = given if isinstance(given, dict) else {}
        if isinstance(given, list) and len(given) == 2:
            kind = next((k for k in get_args(Kind) if name.endswith(k)), None)
            table = {"actual": given[0], "desired": given[1], "kind": kind}
        if not (table.keys() <= MEASURE.keys() and fits(table, table_schema(MEASURE))):
            raise self.fail(
                f"errors.{name}: [actual, desired] signals are expected, with a name that ends in 'position' or "
                f"'orientation'; or {{ actual, desired, kind }} with kind 'position' or 'orientation'"
            )
        return Measure(**table)

    def roles(self, raw: Raw, components: Raw) -> SignalRoles:
        given = read(raw, ROLES, self.fail, subject="roles.", where=" in [roles]")
        declared = {
            role: tuple(value) if isinstance(value, list) else (value,)
            for role, value in given.items()
            if value is not None
        }
        for role, signals in declared.items():
            for component in map(component_of, signals):
                if component not in components:
                    raise self.fail(
                        f"roles.{role}: there is no component {component!r}{did_you_mean(component, components)}"
                    )
        return SignalRoles(declared=declared)

    def time(self, value: float, subject: str) -> int:
        return nanoseconds(value, f"scenario {self.path}: {subject}")


def to_toml(raw: Raw) -> str:
    """Return the merged scenario as TOML. Reading this text returns the same tables."""
    lines: list[str] = []

    def emit(table: Raw, prefix: str) -> None:
        plain = {k: v for k, v in table.items() if not isinstance(v, dict)}
        if prefix and (plain or not table):
            lines.append(f"\n[{prefix}]")
        lines.extend(f"{_key(key)} = {literal(value)}" for key, value in plain.items())
        for key, value in table.items():
            if isinstance(value, dict):
                emit(value, f"{prefix}.{_key(key)}" if prefix else _key(key))

    emit(raw, "")
    return "\n".join(lines).strip() + "\n"


def texts(changes: Changes) -> list[str]:
    """Return changes as arguments of `--set`. Raises ScenarioError."""
    check_changes(changes)
    if not isinstance(changes, Mapping):
        return list(changes)
    return [f"{target}={_as_set(plain(value, target))}" for target, value in changes.items()]


def _latest(changes: Iterable[str]) -> tuple[str, ...]:
    """Return changes without those that a later one overrides."""
    return tuple({change.partition("=")[0].strip(): change for change in changes}.values())


def _as_set(value: object) -> str:
    """Return a value as the VALUE of `--set`."""
    if isinstance(value, dict) and value.keys() == {"value", "unit"}:
        return f"{literal(value['value']).removesuffix('.0')} {value['unit']}"
    return literal(value)


def _key(name: str) -> str:
    return name if BARE_KEY.fullmatch(name) else _text(name)


def _text(value: str) -> str:
    # TOML has the same escape sequences as JSON. In addition, TOML requires an escape sequence for
    # the character DEL.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def literal(value: object) -> str:
    """Return a value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, list):
        items = [literal(item) for item in value]
        return (
            "[" + ", ".join(items) + "]"
            if sum(map(len, items)) < 90
            else "[\n" + "".join(f"  {item},\n" for item in items) + "]"
        )
    if isinstance(value, dict):
        return (
            "{ " + ", ".join(f"{_key(key)} = {literal(item)}" for key, item in value.items()) + " }"
        )
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return repr(value)
