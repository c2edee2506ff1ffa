"""Export of a scenario as a system structure package (SSP).

A system with FMUs of FMI 2.0 is exported as SSP 1.0. A system with FMUs of FMI 3.0 is exported as
SSP 2.0. In SSP, a connector represents a variable of a component. Each element of an FMI 2.0 array
has its own connector. An FMI 3.0 array has one connector with dimensions.

SSP has no elements for communication steps. These steps are written to annotations. The master
programs libcosim and ecos read these annotations. Our own annotations contain all other data for
which SSP has no elements.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable, Mapping
from importlib.metadata import version as installed
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from fmpy.model_description import ModelVariable

from freeflyer.fmi.component import Array, Port
from freeflyer.fmi.fmu import FmuComponent
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import ComponentError, ScenarioError
from freeflyer.foundation.file_name import text_of
from freeflyer.foundation.output_file import check_writable
from freeflyer.foundation.reproducible_zip import write_zip
from freeflyer.foundation.signal_name import split
from freeflyer.scenario.assemble import System, loaded
from freeflyer.scenario.scenario import ComponentSpec, Scenario, to_toml
from freeflyer.scenario.scenario import loaded as scenario_of
from freeflyer.ssp.names import ANNOTATION, DESCRIPTION, FMU_TYPE, SETTINGS, STEP_ANNOTATION, tag

IMPLEMENTATIONS = {"fmu": "CoSimulation", "model_exchange": "ModelExchange"}
BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

Element = ElementTree.Element


def write_ssp(
    scenario: Scenario | str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    fmi: int | None = None,
) -> System:
    """Write a scenario's system, with its FMUs, as one SSP file for other tools.

    `scenario` is a result of `load`, or its argument. `path` ends in .ssp. `fmi` is the FMI version
    of the shipped FMUs: 2 for SSP 1.0, 3 for SSP 2.0 (default: that of the scenario, otherwise 2).
    Returns the assembled system. Raises CosimError.
    """
    file = Path(text_of(path, "the SSP file", ScenarioError))
    if file.suffix != ".ssp":
        raise ScenarioError(f"--out {file}: a file name that ends in .ssp is expected")
    scenario = scenario_of(scenario)
    check_writable(file.parent)
    with loaded(scenario, fmi) as system:
        write(scenario, system, file)
    return system


def write(scenario: Scenario, system: System, path: Path) -> None:
    """Write an SSP file, completely or not at all.

    `system` contains the assembled components of `scenario`. Equal systems result in identical
    files. Raises ScenarioError or ComponentError if SSP cannot represent the system. Raises
    OutputError if the file cannot be written.
    """
    specs = {spec.name: spec for spec in scenario.components}
    components = _checked(specs, system)
    version = "1.0" if all(component.version == 2 for component in components.values()) else "2.0"
    sources = _sources(components)
    files: dict[str, bytes] = {}
    given: dict[str, dict[str, Array]] = {}
    for name, component in components.items():
        files[sources[name]] = component.path.read_bytes()
        given[name] = _changed(component, system.values.get(name, {}))
        if given[name]:
            files[f"resources/{name}.ssv"] = _text(
                _parameter_set(scenario.name, component, given[name], version)
            )
    files[DESCRIPTION] = _text(
        _description(scenario, system, specs, components, given, sources, version)
    )
    write_zip(path, files)


def _checked(specs: Mapping[str, ComponentSpec], system: System) -> dict[str, FmuComponent]:
    found = {
        name: item for name, item in system.components.items() if isinstance(item, FmuComponent)
    }
    for name, spec in specs.items():
        if name not in found or spec.kind not in IMPLEMENTATIONS:
            raise ScenarioError(
                f"component {name} is of kind {spec.kind!r}; only FMUs can be packed into an SSP file"
            )
    if len({component.version for component in found.values()}) > 1:
        raise ScenarioError(
            "the components' FMUs are of FMI 2.0 and of FMI 3.0; FMUs of one version are expected in an SSP file"
        )
    return found


def _sources(components: Mapping[str, FmuComponent]) -> dict[str, str]:
    """Return, for each component, the name of the archive entry that contains its FMU.

    Components with the same FMU file have the same entry.
    """
    places: dict[Path, str] = {}
    for name, component in components.items():
        if component.path not in places:
            wanted = f"resources/{component.path.name}"
            places[component.path] = (
                f"resources/{name}.fmu" if wanted in places.values() else wanted
            )
    return {name: places[component.path] for name, component in components.items()}


def _changed(component: FmuComponent, values: Mapping[str, Array]) -> dict[str, Array]:
    """Return the values that differ from the FMU's start values.

    Only these values are written to the SSP file. The reason is that libcosim and ecos reject a
    file that contains an enumeration. Therefore an enumeration parameter that has its start value
    is left out.
    """
    return {
        name: value
        for name, value in values.items()
        if component.ports[name].start is None
        or not np.array_equal(value, np.array(component.ports[name].start))
    }


# The description


def _description(
    scenario: Scenario,
    system: System,
    specs: Mapping[str, ComponentSpec],
    components: Mapping[str, FmuComponent],
    given: Mapping[str, Mapping[str, Array]],
    sources: Mapping[str, str],
    version: str,
) -> Element:
    # Create the root element.
    root = Element(
        tag("ssd:SystemStructureDescription"),
        version=version,
        name=scenario.name,
        description=scenario.title,
        generationTool=f"freeflyer-cosim {installed('freeflyer-cosim')}",
    )
    # Add the components with connectors, parameters and annotations.
    steps, top = system.steps, _add(root, "ssd:System", name=scenario.name)
    elements = _add(top, "ssd:Elements")
    units: dict[str, dict[str, str]] = {}
    enumerations: dict[str, tuple[str, ...]] = {}
    for name, component in components.items():
        implementation = IMPLEMENTATIONS[specs[name].kind]
        element = _add(
            elements,
            "ssd:Component",
            name=name,
            type=FMU_TYPE,
            source=sources[name],
            implementation=implementation,
        )
        connectors = Element(tag("ssd:Connectors"))
        for variable, port in _interface(component, given[name]):
            _connector(connectors, name, variable, port)
            units |= _unit(component, _unit_name(variable, port), units)
            if port.choices:
                enumerations[f"{name}.{port.name}"] = port.choices
        if len(connectors):
            element.append(connectors)
        if given[name]:
            bindings = _add(element, "ssd:ParameterBindings")
            _add(bindings, "ssd:ParameterBinding", source=f"resources/{name}.ssv")
        annotations = _add(element, "ssd:Annotations")
        _add(
            _annotation(annotations, STEP_ANNOTATION),
            "osp:StepSizeHint",
            value=_number(seconds(steps[name])),
        )
        samples = specs[name].samples
        if samples is not None:
            _add(
                _annotation(annotations, ANNOTATION),
                "freeflyer:Outputs",
                samples=str(samples).lower(),
            )
    # Add the connections, and the definitions of enumerations and units.
    _connections(top, system, components)
    if enumerations:
        _enumerations(root, "ssd:Enumerations", enumerations)
    if units:
        _units(root, "ssd:Units", units)
    # Add the default experiment, and the annotation with the settings of the scenario.
    experiment = _add(
        root, "ssd:DefaultExperiment", startTime="0.0", stopTime=_number(seconds(scenario.stop))
    )
    algorithm = _add(
        _annotation(_add(experiment, "ssd:Annotations"), STEP_ANNOTATION), "osp:Algorithm"
    )
    _add(algorithm, "osp:FixedStepAlgorithm", baseStepSize=_number(seconds(min(steps.values()))))
    settings = {
        key: value for key, value in tomllib.loads(scenario.source).items() if key in SETTINGS
    }
    _add(
        _annotation(_add(root, "ssd:Annotations"), ANNOTATION), "freeflyer:Experiment"
    ).text = to_toml(settings)
    return root


def _interface(
    component: FmuComponent, given: Mapping[str, Array]
) -> Iterable[tuple[ModelVariable, Port]]:
    """Yield the variables that need a connector: inputs, outputs, and parameters in `given`."""
    for port in component.ports.values():
        if port.causality in ("input", "output") or (
            port.name in given and "arameter" in port.causality
        ):
            for variable in component.variables_of(port.name):
                yield variable, port


def _connector(parent: Element, component: str, variable: ModelVariable, port: Port) -> None:
    connector = _add(parent, "ssd:Connector", name=variable.name, kind=port.causality)
    typed = _add(connector, f"ssc:{variable.type}")
    if port.choices:
        typed.set("name", f"{component}.{port.name}")
    unit = _unit_name(variable, port)
    if unit:
        typed.set("unit", unit)
    _dimensions(connector, variable)


def _dimensions(parent: Element, variable: ModelVariable) -> None:
    for size in variable.shape or ():
        _add(parent, "ssc:Dimension", size=str(size))


def _unit_name(variable: ModelVariable, port: Port) -> str | None:
    """Return the unit of the connector of `variable`, which is a model variable of `port`.

    In SSP, as in FMI, an array has only one unit. If the elements of an array have different units,
    the result is None. In this case only the annotation in the FMU contains their units.
    """
    if variable.shape:
        return port.units[0] if len(set(port.units)) == 1 else None
    declared = variable.declaredType
    return variable.unit or (declared.unit if declared else None)


def _connections(top: Element, system: System, components: Mapping[str, FmuComponent]) -> None:
    if not system.wiring.connections:
        return
    parent = _add(top, "ssd:Connections")
    for connection in system.wiring.connections:
        (source, output), (target, taken) = split(connection.source), split(connection.target)
        ends = zip(
            components[source].variables_of(output),
            components[target].variables_of(taken),
            strict=True,
        )
        for start, end in ends:
            element = _add(
                parent,
                "ssd:Connection",
                startElement=source,
                startConnector=start.name,
                endElement=target,
                endConnector=end.name,
            )
            if connection.delayed:
                _add(_annotation(_add(element, "ssd:Annotations"), ANNOTATION), "freeflyer:Delayed")


# Parameters, units, enumerations


def _parameter_set(
    name: str, component: FmuComponent, given: Mapping[str, Array], version: str
) -> Element:
    root = Element(tag("ssv:ParameterSet"), version=version, name=name)
    parameters = _add(root, "ssv:Parameters")
    units: dict[str, dict[str, str]] = {}
    enumerations: dict[str, tuple[str, ...]] = {}
    for key, value in given.items():
        port, first = component.ports[key], 0
        for variable in component.variables_of(key):
            count = int(np.prod(variable.shape or (1,)))
            parameter = _add(parameters, "ssv:Parameter", name=variable.name)
            typed = _add(
                parameter,
                f"ssv:{variable.type}",
                value=_value(port, variable, value[first : first + count]),
            )
            unit = _unit_name(variable, port)
            if unit:
                typed.set("unit", unit)
                units |= _unit(component, unit, units)
            if port.choices:
                typed.set("name", f"{component.name}.{key}")
                enumerations[f"{component.name}.{key}"] = port.choices
            _dimensions(parameter, variable)
            first += count
    if enumerations:
        _enumerations(root, "ssv:Enumerations", enumerations)
    if units:
        _units(root, "ssv:Units", units)
    return root


def _value(port: Port, variable: ModelVariable, numbers: Array) -> str:
    if port.choices:
        return port.choices[int(numbers[0]) - 1]
    if port.boolean:
        return " ".join("true" if number else "false" for number in numbers)
    return " ".join(_number(number) if port.real else str(int(number)) for number in numbers)


def _unit(
    component: FmuComponent, name: str | None, known: Mapping[str, Mapping[str, str]]
) -> dict[str, dict[str, str]]:
    """Return the definition of the unit `name` in SI base units, by the name of the unit.

    SSP requires such a definition. It is read from the FMU. `known` contains the definitions that
    were read earlier. If `name` is None, the result is empty.

    Raises ComponentError if the FMU does not define the unit, or if the definition differs from the
    definition in `known`.
    """
    if name is None:
        return {}
    base = next(
        (unit.baseUnit for unit in component.description.unitDefinitions if unit.name == name), None
    )
    if base is None:
        raise ComponentError(
            f"FMU {component.path} uses the unit {name!r} without a definition in SI base units"
        )
    found = {key: str(getattr(base, key)) for key in BASE_UNITS if getattr(base, key)}
    found |= {
        key: _number(getattr(base, key))
        for key, usual in (("factor", 1.0), ("offset", 0.0))
        if getattr(base, key) != usual
    }
    if known.get(name, found) != found:
        raise ComponentError(
            f"FMU {component.path} defines the unit {name!r} differently from another FMU of the system"
        )
    return {name: found}


def _units(root: Element, name: str, units: Mapping[str, Mapping[str, str]]) -> None:
    parent = _add(root, name)
    for key in sorted(units):
        _add(_add(parent, "ssc:Unit", name=key), "ssc:BaseUnit", **units[key])


def _enumerations(root: Element, name: str, enumerations: Mapping[str, tuple[str, ...]]) -> None:
    parent = _add(root, name)
    for key in sorted(enumerations):
        element = _add(parent, "ssc:Enumeration", name=key)
        for value, choice in enumerate(enumerations[key], start=1):
            _add(element, "ssc:Item", name=choice, value=str(value))


# XML


def _add(parent: Element, name: str, /, **attributes: str) -> Element:
    return ElementTree.SubElement(parent, tag(name), attributes)


def _annotation(parent: Element, kind: str) -> Element:
    return _add(parent, "ssc:Annotation", type=kind)


def _number(value: float) -> str:
    return repr(float(value))


def _text(root: Element) -> bytes:
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text
