"""Description of a run: everything that is needed to repeat it.

summary.json has it under the key `run`. `differences` compares two runs.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from freeflyer.fmi.component import Component
from freeflyer.fmi.fmu_description import describe_fmu
from freeflyer.foundation import toml_file
from freeflyer.foundation.errors import one_line
from freeflyer.foundation.toml_file import as_written
from freeflyer.master.provenance import Provenance
from freeflyer.master.record import Record
from freeflyer.scenario.assemble import OF_FMUS
from freeflyer.scenario.scenario import ComponentSpec, Scenario, to_toml
from freeflyer.scenario.summary_file import FORMAT


def described(
    scenario: Scenario,
    components: Mapping[str, Component],
    provenance: Provenance,
    *,
    fmi: int | None,
    engine: str,
) -> dict[str, Any]:
    """Return the description of a run that starts now, as JSON types.

    `components` are the loaded components. `fmi` and `engine` are the arguments of
    `experiment.run`. `engine` is "devices" for a run with devices.
    """
    source = scenario.source
    if fmi is not None:
        raw = toml_file.parsed(source)
        for spec in scenario.components:
            if spec.kind in OF_FMUS and spec.name in raw["components"]:
                raw["components"][spec.name]["fmi"] = fmi
        source = to_toml(raw)
    return {
        "format": FORMAT,
        "started": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "command": [os.path.basename(sys.argv[0]), *sys.argv[1:]],
        "working_directory": os.getcwd(),
        "machine": dict(_machine()),
        "engine": engine,
        "name": scenario.name,
        "directory": str(scenario.directory.absolute()),
        "ssp": scenario.ssp,
        "changes": list(scenario.changes),
        "scenario": source,
        "parameters": provenance.parameters,
        "files": files(scenario, components),
        "tokens": dict(_tokens(components)),
    }


@functools.cache
def _machine() -> Mapping[str, Any]:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:  # not Linux
        lines = [f"model name : {platform.processor()}"]
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    processor = next(names, "") or platform.machine()
    return {"host": platform.node(), "processor": processor, "cores": os.cpu_count()}


def _tokens(components: Mapping[str, Component]) -> Iterator[tuple[str, str]]:
    """Yield the name of each FMU component, and its instantiation token."""
    for name, component in components.items():
        path = getattr(component, "path", None)
        if isinstance(path, Path):
            description = describe_fmu(path)
            yield name, description.guid


def files(scenario: Scenario, components: Mapping[str, Component]) -> dict[str, str]:
    """Return the SHA-256 of the files of each component.

    These are its FMU, and the existing files among its options.
    """
    found = {}
    for spec in scenario.components:
        digest = hashlib.sha256()
        own = getattr(components[spec.name], "path", None)
        for path in (own, *_named(spec, scenario.directory)):
            if isinstance(path, Path):
                state = path.stat()
                digest.update(_content(path, state.st_mtime_ns, state.st_size))
        found[spec.name] = digest.hexdigest()
    return found


@functools.lru_cache(maxsize=256)
def _content(path: Path, changed: int, size: int) -> bytes:
    return hashlib.sha256(path.read_bytes()).digest()


def _named(spec: ComponentSpec, directory: Path) -> list[Path]:
    """Return the existing files among the options of a component.

    Such an option has the form FILE.fmu, FILE.py or FILE.py:CALLABLE.
    """
    paths = [directory / str(value).partition(":")[0] for value in spec.options.values()]
    return [path for path in paths if path.suffix and path.is_file()]


def differences(
    first: Mapping[str, Any], second: Mapping[str, Any], records: tuple[Record, Record]
) -> list[str]:
    """Return what differs between two runs, in sentences. The list is empty for equal bits.

    `first` and `second` are the contents of their summary.json.
    """
    if records[0].digest == records[1].digest:
        return []
    one, two = first["run"], second["run"]
    found = [
        f"{what} {name}: {one_line(as_written(a), 80)} and {one_line(as_written(b), 80)}"
        for what, pairs in (
            ("parameter", changed(flat(one["parameters"]), flat(two["parameters"]))),
            ("setting", changed(settings(one), settings(two))),
            ("version of", changed(first["versions"], second["versions"])),
            ("machine:", changed(one["machine"], two["machine"])),
        )
        for name, (a, b) in pairs.items()
    ]
    if one["engine"] != two["engine"]:
        found.append(f"engine: {one['engine']!r} and {two['engine']!r}")
    found += [
        f"the files of component {name} are not the same"
        for name in changed(one["files"], two["files"])
    ]
    if first["cause"] != second["cause"]:
        found.append(f"end: {first['cause'] or 'completed'!r} and {second['cause'] or 'completed'!r}")  # fmt: skip
    return [*found, *_columns(*records)]


def _columns(one: Record, two: Record) -> Iterator[str]:
    """Yield a sentence about the numbers that differ."""
    if one.rows != two.rows or not np.array_equal(one.time, two.time):
        yield f"the records have {one.rows} and {two.rows} rows, up to {one.time[-1]:g} and {two.time[-1]:g} s"  # fmt: skip
    rows = min(one.rows, two.rows)
    if set(one) != set(two):
        yield f"only one record has the signals {', '.join(sorted(set(one) ^ set(two)))}"
    gaps = {
        name: float(np.nanmax(np.abs(one[name][:rows] - two[name][:rows])))
        for name in one
        if name in two and not np.array_equal(one[name][:rows], two[name][:rows], equal_nan=True)
    }
    if gaps:
        name = max(gaps, key=gaps.__getitem__)
        yield f"{len(gaps)} signals differ, {name} most, by up to {gaps[name]:.3g}"


def settings(run: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of the scenario of a run, without the parameters of its components.

    Nested keys are joined by dots: {"exchange": "parallel", "record.every_s": 0.01, ...}.
    """
    found: dict[str, Any] = {}

    def take(table: Mapping[str, Any], prefix: str) -> None:
        for key, value in table.items():
            name = f"{prefix}{key}"
            if isinstance(value, dict):
                if not (prefix.startswith("components.") and key == "parameters"):
                    take(value, f"{name}.")
            elif name not in ("title", "paper"):
                found[name] = value

    with suppress(ValueError):  # `load` reports it
        take(toml_file.parsed(run["scenario"]), "")
    return found


def flat(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return parameters as {"COMPONENT.PARAMETER": value}."""
    return {f"{name}.{key}": value for name, own in parameters.items() for key, value in own.items()}  # fmt: skip


def changed(one: Mapping[str, Any], two: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return the items of two mappings that differ. A missing item is None."""
    keys = dict.fromkeys([*one, *two])
    return {key: (one.get(key), two.get(key)) for key in keys if one.get(key) != two.get(key)}
