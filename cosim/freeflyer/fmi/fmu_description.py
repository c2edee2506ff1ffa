"""Reader for the model description, the ports and the terminals of an FMU.

An unusable file raises ComponentError with a clear message. The variables `name[1]` ... `name[n]`
of an FMI 2.0 array are combined into one port. An FMI 3.0 array is one port as well.
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
from freeflyer.foundation.errors import ComponentError

DESCRIPTION = "modelDescription.xml"
MOST_NUMBERS = 1 << 22
"""Largest allowed number of elements of all variables of an FMU."""
ELEMENT = re.compile(r"^(?P<name>.+)\[(?P<index>\d+)\]$")
REAL = ("Real", "Float64")
UNITS_ANNOTATION = "org.freeflyer-cosim.units"
OWN_TOOL = "freeflyer-cosim"
"""Name of the generation tool in our FMUs. Our FMUs keep no state outside their instances."""
Read = TypeVar("Read")


def same_file(path: Path) -> tuple[int, ...]:
    """Return values that change when a file changes. Raises OSError if the file does not exist."""
    status = path.stat()
    return status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def _cached_per_file(read: Callable[[Path], Read]) -> Callable[[Path], Read]:
    """Cache the result of a reader until the file changes. Callers must not modify the result.

    Without the cache, each run of a sweep would need half of its time for reading XML.
    """
    kept: dict[Path, tuple[tuple[int, ...], Read]] = {}

    @functools.wraps(read)
    def once(path: Path) -> Read:
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

    Raises ComponentError if the archive is invalid. This exception can also occur later, while the
    archive is read.
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
        raise ComponentError(f"FMU {path} is refused: {error}") from error


@_cached_per_file
def describe_fmu(path: Path) -> ModelDescription:
    """Read the model description of an FMU. Raises ComponentError if the file is unusable.

    Nothing in the FMU is executed. FMPy parses XML with lxml and does not reject entities and
    document types. Therefore FMPy receives only text that has been checked here.
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
            f"FMU {path} has an invalid {DESCRIPTION}: {sentence(error)}"
        ) from error


def _alone(text: bytes) -> io.BytesIO:
    """Return a zip archive for FMPy. It contains only the model description."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as made:
        made.writestr(DESCRIPTION, text)
    return file


@_cached_per_file
def annotated_units(path: Path) -> dict[str, tuple[str, ...]]:
    """Read the unit of each array element from the annotation in our FMI 3.0 FMUs.

    The annotation is needed because FMI 3.0 allows only one unit per array.
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
    """Read the terminals of an FMU.

    The result contains the members of each terminal, and the variable of each member. FMI 3.0 FMUs
    declare terminals in terminalsAndIcons.xml. Our FMI 2.0 FMUs declare terminals in an annotation.
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
    """Return the result of `ports_of` for an FMU file, with the annotated units.

    Raises ComponentError if the model description is invalid.
    """
    try:
        return ports_of(describe_fmu(path), annotated_units(path))
    except (ValueError, OverflowError) as error:
        raise ComponentError(
            f"FMU {path} has an invalid {DESCRIPTION}: {sentence(error)}"
        ) from error


def ports_of(
    description: ModelDescription, annotated: Mapping[str, tuple[str, ...]]
) -> tuple[dict[str, Port], dict[str, list[ModelVariable]]]:
    """Return the ports by name, and the model variables of each port in order.

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
    # The model structure declares the dependencies of outputs. An output without declared
    # dependencies depends on every input.
    unknown = {id(item.variable): item for item in description.outputs}
    inputs = {
        id(variable) for variable in description.modelVariables if variable.causality == "input"
    }
    owner = {id(variable): name for name, group in groups.items() for variable in group}
    every_input = frozenset(owner[identity] for identity in inputs)
    ports = {}
    for name, group in groups.items():
        first = group[0]
        # Find the unit of each element. Annotated units replace the single unit of an array.
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
        # Collect the inputs on which the port depends directly.
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


def sentence(error: Exception) -> str:
    """Return the message of an exception on one line of at most 300 characters."""
    return " ".join(str(error).split())[:300]
