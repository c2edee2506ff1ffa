"""Conversion of a system structure package (SSP) to a scenario.

SSP files of versions 1.0 and 2.0 are accepted from any tool. A system contains components and
further systems. Nested systems are flattened: the scenario contains all components and connections
in one level. The parameter sets of all levels are collected. Unsupported content is rejected.

SSP has no elements for communication steps. The step of a component is taken from the first of
these sources that contains a step: the annotation of the component, the argument `step`, the
annotation of the default experiment, and the default experiments of the FMUs.
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from fmpy.model_description import ModelDescription

from freeflyer.fmi.component import Port
from freeflyer.fmi.fmu_description import describe_fmu, ports_of
from freeflyer.foundation import toml_file
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.file_name import text_of
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.foundation.temporary_folder import TemporaryFolder
from freeflyer.foundation.units import DIMENSIONLESS, same
from freeflyer.scenario.inheritance import Raw
from freeflyer.scenario.overrides import Changes, apply
from freeflyer.scenario.scenario import Scenario, from_tables, texts
from freeflyer.ssp.names import (
    ANNOTATION,
    DESCRIPTION,
    FMU_TYPE,
    NAMESPACES,
    SETTINGS,
    STEP_ANNOTATION,
    tag,
)
from freeflyer.ssp.package import Package, opened

Element = ElementTree.Element
Node = tuple[tuple[str, ...], str]
"""A connector of a component or of a system.

The first item is the path of the component or system: the names of the systems around it, and its
own name. The second item is the name of the connector.
"""


def load_ssp(
    path: str | os.PathLike[str], changes: Changes = (), *, step: float | None = None
) -> Scenario:
    """Return a scenario from the SSP file `path`.

    `changes` are those of `freeflyer.load`. `step` [s] is the communication step of each component
    for which the file contains no step. The unpacked FMUs exist as long as the scenario and the
    results of its runs. Raises CosimError if the file is invalid or contains unsupported content.
    """
    if step is not None and not 0.0 < step < float("inf"):
        raise ScenarioError(f"--step {step:g}: a time above zero is expected")
    file = Path(text_of(path, "the SSP file", ScenarioError))
    unpacked = TemporaryFolder()
    found = read(file, unpacked.path, step=step, overrides=changes)
    source = {"path": str(file.absolute()), "step": step}
    return replace(found, keeps=unpacked, ssp=source, changes=tuple(texts(changes)))


def read(
    path: Path, directory: Path, *, step: float | None = None, overrides: Changes = ()
) -> Scenario:
    """Read a scenario from an SSP file, and unpack its FMUs into `directory`.

    The directory must exist as long as the scenario is used. `step` [s] is the communication step
    of each component for which the file contains no step. `overrides` are changes of the scenario,
    for example ["stop_s=10"].

    Raises CosimError if the file is invalid or contains unsupported content.
    """
    with opened(path, directory) as package:
        raw = _System(package).tables(step, overrides)
    apply(raw, overrides)
    return from_tables(raw, path)


@dataclass(kw_only=True)
class _Part:
    """One FMU of the flattened system."""

    name: str
    path: Path
    kind: str
    description: ModelDescription
    ports: Mapping[str, Port]
    owner: Mapping[str, tuple[str, int]]
    """For each model variable: the name of its port, and its index among the port's variables.

    The elements of an FMI 2.0 array are separate model variables of one port.
    """
    width: Mapping[str, int]
    """For each port: the number of its model variables."""
    parameters: dict[str, Any] = field(default_factory=dict)
    step: float | None = None
    samples: bool | None = None


class _System:
    """The flattened system. This class reads FMUs and connections from SystemStructure.ssd.

    `parts` contains the FMUs, and `elements` contains the paths of all components and systems.
    Each item of `edges` is a connection: start connector, end connector, and whether it is delayed.
    """

    def __init__(self, package: Package) -> None:
        self.package, self.fail = package, package.fail
        self.parts: dict[tuple[str, ...], _Part] = {}
        self.edges: list[tuple[Node, Node, bool]] = []
        self.elements: set[tuple[str, ...]] = {()}
        self.unmatched: list[str] = []
        """Names of parameters that match no variable of an FMU in this system."""

    def tables(self, step: float | None, overrides: Changes) -> Raw:
        """Read SystemStructure.ssd and return the tables of the scenario.

        For `step` and `overrides`, see `read`.
        """
        root = self.package.xml(DESCRIPTION, "ssd:SystemStructureDescription")
        if not root.get("version", "").startswith(("1.", "2.")):
            raise self.fail(
                f"it is of version {root.get('version')}; SSP 1.0 and 2.0 are supported"
            )
        system = root.find("ssd:System", NAMESPACES)
        if system is None:
            raise self.fail(f"{DESCRIPTION} has no System")
        self._system(system, ())
        self._parameters(system, (), [])
        if not self.parts:
            raise self.fail("it has no components")
        return self._raw(root, step, overrides)

    # The system

    def _system(self, system: Element, where: tuple[str, ...]) -> None:
        kinds: dict[Node, str] = {}
        self._kinds(system, where, kinds)
        for element in system.iterfind("ssd:Elements/*", NAMESPACES):
            place = (*where, element.get("name", ""))
            if place in self.elements:
                raise self.fail(f"two elements have the name {'.'.join(place)!r}")
            self.elements.add(place)
            if element.tag == tag("ssd:System"):
                self._system(element, place)
            elif element.tag == tag("ssd:Component"):
                self.parts[place] = self._component(element, place)
            else:
                raise self.fail(
                    f"{'.'.join(place)} is a {element.tag.partition('}')[2]}; components and systems are supported"
                )
            self._kinds(element, place, kinds)
        for connection in system.iterfind("ssd:Connections/ssd:Connection", NAMESPACES):
            self._connection(connection, where, kinds)

    def _kinds(self, element: Element, place: tuple[str, ...], kinds: dict[Node, str]) -> None:
        for connector in element.iterfind("ssd:Connectors/ssd:Connector", NAMESPACES):
            kinds[place, connector.get("name", "")] = connector.get("kind", "")

    def _component(self, element: Element, place: tuple[str, ...]) -> _Part:
        # Unpack the FMU. Other component types are not supported.
        subject = f"component {'.'.join(place)}"
        if element.get("type", FMU_TYPE) != FMU_TYPE:
            raise self.fail(
                f"{subject} is of type {element.get('type')}; FMUs ({FMU_TYPE}) are supported"
            )
        if element.get("source") is None:
            raise self.fail(f"{subject} has no source; an FMU in the archive is expected")
        path = self.package.unpack(self.package.source(element, subject))
        description = describe_fmu(path)
        # Choose co-simulation or model exchange.
        wanted = element.get("implementation", "any")
        if wanted == "ScheduledExecution":
            raise self.fail(
                f"{subject} is for scheduled execution; co-simulation and model exchange are supported"
            )
        if wanted not in ("any", "CoSimulation", "ModelExchange"):
            raise self.fail(
                f"{subject} has the implementation {wanted!r}; CoSimulation, ModelExchange or any is expected"
            )
        exchanged = wanted == "ModelExchange" or (
            wanted == "any" and description.coSimulation is None
        )
        # Read the ports, and the settings in annotations.
        ports, groups = ports_of(description, {})
        part = _Part(
            name=self._free_name(place),
            path=path,
            kind="model_exchange" if exchanged else "fmu",
            description=description,
            ports=ports,
            owner={
                variable.name: (name, i)
                for name, group in groups.items()
                for i, variable in enumerate(group)
            },
            width={name: len(group) for name, group in groups.items()},
        )
        hint = self._annotated(element, STEP_ANNOTATION, "osp:StepSizeHint")
        part.step = self._positive(hint, "value", subject) if hint is not None else None
        outputs = self._annotated(element, ANNOTATION, "freeflyer:Outputs")
        part.samples = outputs.get("samples") == "true" if outputs is not None else None
        return part

    def _free_name(self, place: tuple[str, ...]) -> str:
        """Return a component name for the element with the path `place`.

        The name is not used yet, and contains only letters, digits and underscores.
        """
        name = re.sub(r"\W", "_", "_".join(place), flags=re.ASCII)
        name = name if name.isidentifier() else f"_{name}"
        taken = {part.name for part in self.parts.values()}
        while name in taken:
            name += "_"
        return name

    def _connection(
        self, element: Element, where: tuple[str, ...], kinds: Mapping[Node, str]
    ) -> None:
        start, end = (self._end(element, side, where) for side in ("start", "end"))
        subject = f"connection {shown(start)} -> {shown(end)}"
        for transformation in element.iterfind("ssc:*", NAMESPACES):
            if transformation.tag.endswith("Transformation") and not self._identical(
                transformation
            ):
                raise self.fail(f"{subject} transforms its value, which is not supported")
        for side in ("startIndices", "endIndices"):
            if element.get(side):
                raise self.fail(
                    f"{subject} connects single elements of an array, which is not supported"
                )
        # In SSP, `start` need not be the source of the data. The kinds of the connectors decide.
        if self._takes(end, where, kinds) is False or self._takes(start, where, kinds) is True:
            start, end = end, start
        delayed = self._annotated(element, ANNOTATION, "freeflyer:Delayed") is not None
        self.edges.append((start, end, delayed))

    def _end(self, element: Element, side: str, where: tuple[str, ...]) -> Node:
        owner = element.get(f"{side}Element")
        node = (
            ((*where, owner) if owner is not None else where),
            element.get(f"{side}Connector", ""),
        )
        if node[0] not in self.elements:
            known = sorted(place[-1] for place in self.elements if place)
            raise self.fail(
                f"a connection names the element {owner!r}, which does not exist{did_you_mean(owner or '', known)}"
            )
        part = self.parts.get(node[0])
        if part is not None and node[1] not in part.owner:
            raise self.fail(
                f"the FMU of component {part.name} has no variable {node[1]!r}{did_you_mean(node[1], part.owner)}"
            )
        return node

    def _takes(self, node: Node, where: tuple[str, ...], kinds: Mapping[Node, str]) -> bool | None:
        """Return True if a connection transfers data to the connector `node`.

        The result is False if the connection transfers data from the connector, and None if the
        direction is unknown. `where` is the path of the system that contains the connection.
        """
        part = self.parts.get(node[0])
        kind = part.ports[part.owner[node[1]][0]].causality if part else kinds.get(node, "")
        takes = {
            "input": True,
            "parameter": True,
            "output": False,
            "calculatedParameter": False,
        }.get(kind)
        # If the connector belongs to the system that contains the connection, the direction is
        # reversed. Inside a system, a connection transfers data from an input of this system to a
        # component.
        return takes if takes is None or node[0] != where else not takes

    # Parameters

    def _parameters(
        self, element: Element, place: tuple[str, ...], above: list[tuple[str, Any]]
    ) -> None:
        """Collect the parameters of an element and of the elements inside it.

        `above` contains the parameters from the systems around this element: names and values. The
        names are relative to this element. The values in `above` replace the values that this
        element sets itself.
        """
        values = [*self._bound(element, place), *above]
        part = self.parts.get(place)
        if part is not None:
            part.parameters = self._grouped(part, values)
        known = (
            part.owner
            if part is not None
            else {
                f"{child.get('name', '')}."
                for child in element.iterfind("ssd:Elements/*", NAMESPACES)
            }
        )
        self.unmatched += [
            ".".join((*place, key))
            for key, _ in values
            if not (key in known if part else key.startswith(tuple(known)))
        ]
        for child in element.iterfind("ssd:Elements/*", NAMESPACES):
            name = child.get("name", "")
            below = [
                (key.removeprefix(f"{name}."), value)
                for key, value in values
                if key.startswith(f"{name}.")
            ]
            self._parameters(child, (*place, name), below)

    def _bound(self, element: Element, place: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
        subject = f"a parameter binding of {'.'.join(place) or 'the system'}"
        for binding in element.iterfind("ssd:ParameterBindings/ssd:ParameterBinding", NAMESPACES):
            found: Element | None = binding.find("ssd:ParameterValues/ssv:ParameterSet", NAMESPACES)
            if binding.get("source"):
                found = self.package.xml(self.package.source(binding, subject), "ssv:ParameterSet")
            if found is None:
                raise self.fail(f"{subject} has no parameter set")
            mapping = self._mapping(binding, subject)
            for parameter in found.iterfind("ssv:Parameters/ssv:Parameter", NAMESPACES):
                name = binding.get("prefix", "") + parameter.get("name", "")
                value = self._value(parameter, f"parameter {name}")
                yield from ((target, value) for target in mapping.get(name, [name]))

    def _mapping(self, binding: Element, subject: str) -> dict[str, list[str]]:
        element = binding.find("ssd:ParameterMapping", NAMESPACES)
        if element is None:
            return {}
        found: Element | None = element.find("ssm:ParameterMapping", NAMESPACES)
        if element.get("source"):
            found = self.package.xml(self.package.source(element, subject), "ssm:ParameterMapping")
        targets: dict[str, list[str]] = {}
        for entry in found.iterfind("ssm:MappingEntry", NAMESPACES) if found is not None else ():
            if any(
                not self._identical(child)
                for child in entry
                if child.tag.endswith("Transformation")
            ):
                raise self.fail(
                    f"{subject} transforms parameter {entry.get('source')}, which is not supported"
                )
            targets.setdefault(entry.get("source", ""), []).append(entry.get("target", ""))
        return targets

    def _value(self, parameter: Element, subject: str) -> Any:
        """Return the value of a parameter in the form that a scenario requires.

        The result is a number, a Boolean, the name of an enumeration item, or a list of numbers or
        Booleans. If the parameter has a unit, the result is a table { value, unit }.
        """
        typed = next(
            (child for child in parameter if child.tag.startswith(f"{{{NAMESPACES['ssv']}}}")), None
        )
        if typed is None:
            raise self.fail(f"{subject} has no value")
        kind, text = typed.tag.partition("}")[2], typed.get("value", "")
        if kind == "Enumeration":
            return text
        if kind == "Boolean":
            unsupported = [item for item in text.split() if item not in ("true", "false", "1", "0")]
            if unsupported:
                raise self.fail(f"{subject} is {unsupported[0]!r}; true or false is expected")
            items: list[Any] = [item in ("true", "1") for item in text.split()]
        elif kind in ("String", "Binary", "Clock"):
            raise self.fail(
                f"{subject} is of type {kind}; numbers, Booleans and enumerations are supported"
            )
        else:
            try:
                items = [
                    float(item) if kind in ("Real", "Float64", "Float32") else int(item)
                    for item in text.split()
                ]
            except ValueError:
                raise self.fail(f"{subject} is {text!r}; {kind} is expected") from None
        value = items[0] if len(items) == 1 else items
        return {"value": value, "unit": typed.get("unit")} if typed.get("unit") else value

    def _grouped(self, part: _Part, values: list[tuple[str, Any]]) -> dict[str, Any]:
        """Combine the values of model variables into values of ports.

        `values` contains names of model variables and their values. Names that are not model
        variables of this FMU are ignored.
        """
        # For each port: the values by the index of the model variable among the port's variables. A
        # later value replaces an earlier value.
        given: dict[str, dict[int, Any]] = {}
        for name, value in values:
            if name in part.owner:
                owner, index = part.owner[name]
                given.setdefault(owner, {})[index] = value
        result: dict[str, Any] = {}
        for name, items in given.items():
            port = part.ports[name]
            if part.width[name] == 1:
                result[name] = _plain(items[0], port.units[0])
                continue
            if port.start is None and len(items) < port.size:
                raise self.fail(
                    f"only some elements of {part.name}.{name} are set, and the FMU has no start values for the other elements"
                )
            elements = [
                _plain(items.get(i, start), port.units[i])
                for i, start in enumerate(port.start or [0.0] * port.size)
            ]
            if any(isinstance(element, dict) for element in elements):
                raise self.fail(
                    f"elements of {part.name}.{name} are set one by one in units that differ from the FMU's units, which is not supported"
                )
            result[name] = elements
        return result

    # The scenario

    def _raw(self, root: Element, step: float | None, overrides: Changes) -> Raw:
        # A scenario starts at time 0.
        experiment = root.find("ssd:DefaultExperiment", NAMESPACES)
        times = experiment.attrib if experiment is not None else {}
        if self._number(times.get("startTime", "0"), "the start time") != 0.0:
            raise self.fail(
                f"it starts at {times['startTime']} s; only runs that start at 0 are supported"
            )
        # Read the settings of the experiment from our annotation.
        raw: Raw = {"title": root.get("description") or root.get("name", "")}
        settings = self._annotated(root, ANNOTATION, "freeflyer:Experiment")
        if settings is None:
            # The file is from another SSP tool. Such tools use parallel exchange. In parallel
            # exchange, the components have no execution order. Therefore an algebraic loop is not
            # an error.
            raw["exchange"] = "parallel"
        else:
            try:
                raw |= {
                    key: value
                    for key, value in toml_file.parsed(settings.text or "").items()
                    if key in SETTINGS
                }
            except ValueError as error:
                raise self.fail(
                    f"its annotation {ANNOTATION} is not valid TOML: {error}"
                ) from error
        # Read the stop time.
        if "stopTime" in times:
            raw["stop_s"] = self._number(times["stopTime"], "the stop time")
        if "stop_s" not in raw and not any(
            text.partition("=")[0].strip() == "stop_s" for text in overrides
        ):
            raise self.fail("it has no stop time: set it with --set stop_s=SECONDS")
        if step is not None and all(part.step is not None for part in self.parts.values()):
            raise self.fail("--step has no effect: every component has its step in the file")
        # In our files, a parameter that matches no variable of an FMU is an error. Files of other
        # tools may contain a parameter set that is used for several systems. Therefore such
        # parameters are allowed in these files.
        if settings is not None and self.unmatched:
            raise self.fail(f"parameter {self.unmatched[0]} belongs to none of its FMUs")
        # Create the tables of components and connections.
        common = step or self._common_step(experiment)
        raw["components"] = {part.name: self._table(part, common) for part in self.parts.values()}
        raw["connections"], raw["delayed"] = self._joined()
        smallest = min(table["step_s"] for table in raw["components"].values())
        raw.setdefault("record", {"every_s": smallest * max(1, round(0.01 / smallest))})
        return raw

    def _common_step(self, experiment: Element | None) -> float | None:
        found = (
            None
            if experiment is None
            else self._annotated(
                experiment, STEP_ANNOTATION, "osp:Algorithm/osp:FixedStepAlgorithm"
            )
        )
        if found is not None:
            return self._positive(found, "baseStepSize", "the default experiment")
        offered = [part.description.defaultExperiment for part in self.parts.values()]
        steps = [float(item.stepSize) for item in offered if item is not None and item.stepSize]
        return min(steps) if steps else None

    def _table(self, part: _Part, common: float | None) -> Raw:
        step = part.step or common
        if step is None:
            raise self.fail(
                f"component {part.name} has no communication step; set the step with --step"
            )
        table: Raw = {
            "kind": part.kind,
            "fmu": str(part.path.resolve()),
            "step_s": step,
            "parameters": part.parameters,
        }
        return table if part.samples is None else table | {"samples": part.samples}

    def _joined(self) -> tuple[list[str], list[str]]:
        """Return two lists of connections between whole ports: not delayed, and delayed.

        In the file, a connection connects single model variables. It may end at a connector of a
        nested system. Therefore each connection to an FMU is followed back through such connectors,
        until the connector of another FMU is found.
        """
        # Check that each connector has at most one source.
        giver = {end: (start, delayed) for start, end, delayed in self.edges}
        ends = Counter(end for _, end, _ in self.edges)
        twice = [end for end, count in ends.items() if count > 1]
        if twice:
            raise self.fail(f"{shown(twice[0])} has two sources")
        # The keys are pairs of an output port and an input port. The value describes the
        # connections between their variables. It maps the index of a variable in the input port to
        # two items: the index of the connected variable in the output port, and whether the
        # connection is delayed.
        pairs: dict[tuple[str, str], dict[int, tuple[int, bool]]] = {}
        for end in giver:
            if end[0] not in self.parts:
                continue
            start, delayed = giver[end]
            passed = {end}
            while start in giver and start[0] not in self.parts and start not in passed:
                passed.add(start)
                start, further = giver[start]
                delayed |= further
            if start[0] not in self.parts:
                continue  # the source is an input of the whole system
            source, target = self.parts[start[0]], self.parts[end[0]]
            (output, i), (taken, j) = source.owner[start[1]], target.owner[end[1]]
            pairs.setdefault((f"{source.name}.{output}", f"{target.name}.{taken}"), {})[j] = (
                i,
                delayed,
            )
        # Only connections of whole ports with the same order of elements are supported.
        prompt: list[str] = []
        delays: list[str] = []
        width = {
            f"{part.name}.{name}": count
            for part in self.parts.values()
            for name, count in part.width.items()
        }
        for (output, taken), elements in pairs.items():
            whole = width[output] == width[taken] == len(elements) and all(
                i == j for j, (i, _) in elements.items()
            )
            if not whole or len({delayed for _, delayed in elements.values()}) > 1:
                raise self.fail(
                    f"{output} and {taken} are connected only in part, or in a different order of elements; only connections of whole arrays are supported"
                )
            (delays if elements[0][1] else prompt).append(f"{output} -> {taken}")
        return prompt, delays

    # Annotations

    def _annotated(self, element: Element, kind: str, path: str) -> Element | None:
        for annotation in element.iterfind("ssd:Annotations/ssc:Annotation", NAMESPACES):
            found = annotation.find(path, NAMESPACES)
            if annotation.get("type") == kind and found is not None:
                return found
        return None

    def _positive(self, element: Element, attribute: str, subject: str) -> float:
        value = self._number(element.get(attribute, ""), f"the step of {subject}")
        if value < 1e-9:
            raise self.fail(f"the step of {subject} is {value} s; at least 1e-9 s is expected")
        return value

    def _number(self, text: str, subject: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.fail(f"{subject} is {text!r}; a number is expected")
        return value

    def _identical(self, transformation: Element) -> bool:
        if transformation.tag != tag("ssc:LinearTransformation"):
            return False
        factor = self._number(transformation.get("factor", "1"), "the factor of a transformation")
        return (
            factor == 1.0
            and self._number(transformation.get("offset", "0"), "the offset of a transformation")
            == 0.0
        )


def shown(node: Node) -> str:
    """Format a connector for a message."""
    return ".".join((*node[0], node[1]))


def _plain(value: Any, unit: str | None) -> Any:
    """Return a value without its unit, if the value needs no conversion to the unit of the FMU.

    `unit` is the unit of the FMU. If `unit` is None, no conversion is needed. If a conversion is
    needed, return the value unchanged.
    """
    if isinstance(value, dict) and (
        unit is None or value["unit"] == unit or same(value["unit"], unit or DIMENSIONLESS)
    ):
        return value["value"]
    return value
