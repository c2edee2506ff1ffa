"""Reader for the model description, the ports and the terminals of an FMU.

If an FMU is unusable, ComponentError is raised and the message contains the reason. A port is a
scalar variable or a whole array. FMI 2.0 has no arrays. Therefore FMI 2.0 variables with the names
`name[1]` ... `name[n]` are combined into one port. An FMI 3.0 array is one port as well.
"""

from __future__ import annotations

import functools
import io
import math
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from fmpy.model_description import ModelDescription, ModelVariable, read_model_description

from freeflyer.fmi import archive
from freeflyer.fmi.archive import Archive, ArchiveError
from freeflyer.fmi.component import Port
from freeflyer.foundation.errors import ComponentError, one_line
from freeflyer.foundation.own_fmus import UNITS_ANNOTATION

DESCRIPTION = "modelDescription.xml"
MOST_NUMBERS = 1 << 22
"""Largest allowed number of elements in an FMU. A scalar variable counts as one element."""
ELEMENT = re.compile(r"^(?P<name>.+)\[(?P<index>\d+)\]$")
REAL = ("Real", "Float64")
Read = TypeVar("Read")


def same_file(path: Path) -> tuple[int, ...]:
    """Return numbers that identify the present version of a file. They change if the file changes.

    Raises OSError if the file does not exist.
    """
    status = path.stat()
    return status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def _cached_per_file(read: Callable[[Path], Read]) -> Callable[[str | Path], Read]:
    """Cache the result of the function `read` for each file, until the file changes.

    Callers must not modify the result, because later callers receive the same object. Without the
    cache, each run of a sweep would need half of its time for reading XML.
    """
    kept: dict[Path, tuple[tuple[int, ...], Read]] = {}

    @functools.wraps(read)
    def once(path: str | Path) -> Read:
        path = Path(path)
        try:
            state = same_file(path)
        except (OSError, ValueError):
            return read(path)  # this call raises the appropriate exception
        if path not in kept or kept[path][0] != state:
            kept[path] = (state, read(path))
        return kept[path][1]

    return once


@contextmanager
def opened(path: Path) -> Iterator[Archive]:
    """Open and check an FMU's archive.

    Raises ComponentError if the archive is invalid. The `with` block can also raise ComponentError,
    when it reads an invalid entry.
    """
    if not path.is_file():
        raise ComponentError(
            f"FMU {path} " + ("is not a file" if path.exists() else "does not exist")
        )
    if not zipfile.is_zipfile(path):
        raise ComponentError(f"{path} is not an FMU: it is not a zip archive")
    try:
        with archive.opened(path) as found:
            if DESCRIPTION not in found.names:
                raise ComponentError(f"{path} is not an FMU: it contains no {DESCRIPTION}")
            yield found
    except ArchiveError as error:
        raise ComponentError(f"FMU {path} is rejected: {error}") from error


@_cached_per_file
def describe_fmu(path: Path) -> ModelDescription:
    """Read the model description of the FMU at `path`, as FMPy represents it.

    Raises ComponentError if the FMU is unusable.

    Nothing in the FMU is executed. FMPy parses XML with lxml, and accepts entities and document
    types. Therefore FMPy receives only XML text that `Archive.xml` has checked.
    """
    try:
        with opened(path) as found:
            root, text = found.xml(DESCRIPTION)
        version = root.get("fmiVersion", "unknown")
        if not version.startswith(("2.", "3.")):
            raise ComponentError(
                f"FMU {path} is of FMI version {version}; FMI 2.0 and FMI 3.0 are supported"
            )
        return read_model_description(_alone(text))
    except OSError as error:
        raise ComponentError(f"FMU {path} cannot be read: {error.strerror}") from error
    except ComponentError:
        raise
    except Exception as error:  # FMPy raises plain Exception for an invalid description
        raise ComponentError(
            f"FMU {path} has an invalid {DESCRIPTION}: {one_line(error, 300)}"
        ) from error


def _alone(text: bytes) -> io.BytesIO:
    """Return a zip archive that contains only the model description `text`.

    FMPy accepts text in memory only in this form.
    """
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as made:
        made.writestr(DESCRIPTION, text)
    return file


@_cached_per_file
def annotated_units(path: Path) -> dict[str, tuple[str, ...]]:
    """Return the units of the elements of FMI 3.0 arrays, by the name of the array.

    FMI 3.0 allows only one unit per array. Therefore our FMI 3.0 FMUs contain these units in an
    annotation. For an FMU without this annotation, the result is empty.
    """
    with opened(path) as found:
        root, _ = found.xml(DESCRIPTION)
    units = {}
    for variable in root.iterfind("ModelVariables/*"):
        for annotation in variable.iterfind("Annotations/Annotation"):
            if annotation.get("type") == UNITS_ANNOTATION and annotation.text:
                units[variable.get("name", "")] = tuple(annotation.text.split())
    return units


@_cached_per_file
def terminals_of(path: Path) -> dict[str, dict[str, str]]:
    """Return the terminals of an FMU.

    A terminal is a named group of variables. These variables are its members. The keys of the
    result are the names of the terminals. Each value maps the names of the members to names of
    variables.

    FMI 3.0 FMUs declare terminals in the file terminalsAndIcons.xml. Our FMI 2.0 FMUs declare
    terminals in an annotation of the model description.
    """
    with opened(path) as found:
        inside = "terminalsAndIcons/terminalsAndIcons.xml"
        root, _ = found.xml(inside if inside in found.names else DESCRIPTION)
    return {
        terminal.get("name", ""): {
            member.get("memberName", ""): member.get("variableName", "")
            for member in terminal.iterfind("TerminalMemberVariable")
        }
        for terminal in root.iterfind(".//Terminals/Terminal")
    }


@_cached_per_file
def ports_in(path: Path) -> tuple[dict[str, Port], dict[str, list[ModelVariable]]]:
    """Return the result of `ports_of` for an FMU file, with the units of `annotated_units`.

    Raises ComponentError if the model description is invalid.
    """
    try:
        return ports_of(describe_fmu(path), annotated_units(path))
    except (ValueError, OverflowError) as error:
        raise ComponentError(
            f"FMU {path} has an invalid {DESCRIPTION}: {one_line(error, 300)}"
        ) from error


def ports_of(
    description: ModelDescription, annotated: Mapping[str, tuple[str, ...]]
) -> tuple[dict[str, Port], dict[str, list[ModelVariable]]]:
    """Return the ports by name, and the model variables of each port by the name of the port.

    The variables of a port have the order of its elements. `annotated` is the result of
    `annotated_units`.

    Raises ValueError for an invalid number or for more than MOST_NUMBERS elements.
    """
    # Check the limit before memory for the elements is allocated.
    numbers = sum(map(_size, description.modelVariables))
    if numbers > MOST_NUMBERS:
        raise ValueError(f"its variables have {numbers} elements; {MOST_NUMBERS} are allowed")
    # Combine the elements of an FMI 2.0 array into one port.
    groups: dict[str, list[ModelVariable]] = {}
    for variable in description.modelVariables:
        match = ELEMENT.match(variable.name)
        groups.setdefault(match["name"] if match else variable.name, []).append(variable)
    # The element ModelStructure of the model description declares the inputs on which an output
    # depends. According to FMI, an output without this declaration depends on every input.
    unknown = {id(item.variable): item for item in description.outputs}
    inputs = {
        id(variable) for variable in description.modelVariables if variable.causality == "input"
    }
    owner = {id(variable): name for name, group in groups.items() for variable in group}
    every_input = frozenset(owner[identity] for identity in inputs)
    ports = {}
    for name, group in groups.items():
        first = group[0]
        # Find the unit of each element. Annotated units replace the unit that the array declares
        # for all its elements.
        sizes = [_size(variable) for variable in group]
        units: list[str | None] = []
        for variable, size in zip(group, sizes, strict=True):
            units += [
                variable.unit or (variable.declaredType.unit if variable.declaredType else None)
            ] * size
        units = list(annotated.get(name, units))
        items = (
            first.declaredType.items if first.type == "Enumeration" and first.declaredType else []
        )
        # Collect the inputs on which the port depends at the same instant.
        direct: set[str] = set()
        for variable in group:
            item = unknown.get(id(variable))
            if item is None or item.dependencies is None:
                direct |= every_input if variable.causality == "output" else frozenset()
            else:
                direct |= {owner[id(v)] for v in item.dependencies if id(v) in inputs}
        starts = [value for variable in group for value in _start(variable)]
        ports[name] = Port(
            name=name,
            size=sum(sizes),
            causality=first.causality or "local",
            units=tuple(units),
            start=tuple(starts) if len(starts) == sum(sizes) else None,
            settable=first.causality in ("parameter", "structuralParameter")
            or (first.causality != "input" and first.initial in ("exact", "approx")),
            choices=tuple(item.name for item in items),
            boolean=first.type == "Boolean",
            real=first.type in REAL,
            direct=frozenset(direct),
            sampled=first.causality == "output" and first.variability == "discrete",
        )
    return ports, groups


def _size(variable: ModelVariable) -> int:
    dimensions = variable.shape or [dimension.start or 1 for dimension in variable.dimensions]
    return math.prod(map(int, dimensions))


def _start(variable: ModelVariable) -> list[float]:
    if variable.start is None or variable.type in ("String", "Binary"):
        return []
    items = str(variable.start).split()
    return [float({"true": 1, "false": 0}.get(item.lower(), item)) for item in items]
