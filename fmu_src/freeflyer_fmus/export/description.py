"""Generation of modelDescription.xml from a block, for FMI 2.0 and FMI 3.0."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from xml.etree import ElementTree

from freeflyer.foundation.own_fmus import OWN_TOOL, REQUIREMENT, UNITS_ANNOTATION
from freeflyer_fmus.blocks.block import Block, Variable
from freeflyer_fmus.export.layout import Layout, derivative_elements, derivative_name, layout
from freeflyer_fmus.units import DISPLAY, UNITS, rate

TERMINAL_KINDS = "org.freeflyer-cosim"
LOG_CATEGORIES = {
    "logStatusError": "Rejected calls and values",
    REQUIREMENT: "Violated requirements of the equations, for example a singular Jacobian",
}
TYPES = {"real": "Float64", "boolean": "Boolean", "enumeration": "Enumeration"}
"""Names of the types in FMI 3.0. FMI 2.0 has the type Real instead of Float64."""

Element = ElementTree.Element
add = ElementTree.SubElement


def text(root: Element) -> bytes:
    ElementTree.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root) + b"\n"


def number(value: float) -> str:
    return repr(float(value))


def fmi2(block: Block, token: str, sources: Sequence[str] = ()) -> bytes:
    """Return modelDescription.xml of FMI 2.0, in which every array element is a variable.

    `sources` are the names of the C files that the FMU contains.
    """
    root = _root(block, "2.0", {"guid": token})
    root.set("numberOfEventIndicators", "0")
    capabilities = {
        "modelIdentifier": block.name,
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "canNotUseMemoryManagementFunctions": "true",
        "providesDirectionalDerivative": "true",
    }
    # A sampled block has no model exchange.
    if not block.is_sampled:
        add(root, "ModelExchange", capabilities, completedIntegratorStepNotNeeded="true")
    add(root, "CoSimulation", capabilities, canHandleVariableCommunicationStepSize="true")
    for interface in list(root) if sources else []:
        listed = add(interface, "SourceFiles")
        for name in sources:
            add(listed, "File", name=name)
    _definitions(
        root, block, lambda types, name: add(add(types, "SimpleType", name=name), "Enumeration")
    )
    # FMI 2.0 does not define terminals. Therefore the terminals are in a vendor annotation.
    if block.terminals:
        _terminals(add(add(root, "VendorAnnotations"), "Tool", name=TERMINAL_KINDS), block)
    index = _fmi2_variables(add(root, "ModelVariables"), block, layout(block))
    _fmi2_structure(add(root, "ModelStructure"), block, index)
    return text(root)


def fmi3(block: Block, token: str) -> bytes:
    """Return modelDescription.xml of FMI 3.0, in which an array is one variable."""
    root = _root(block, "3.0", {"instantiationToken": token})
    capabilities = {
        "modelIdentifier": block.name,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true",
        "providesAdjointDerivatives": "true",
    }
    # A sampled block has no model exchange.
    if not block.is_sampled:
        add(root, "ModelExchange", capabilities, needsCompletedIntegratorStep="false")
        # A continuous block divides a communication step into inner steps (integration steps).
        # Between two inner steps, it supports intermediate update and early return.
        capabilities["providesIntermediateUpdate"] = "true"
        capabilities["canReturnEarlyAfterIntermediateUpdate"] = "true"
    add(root, "CoSimulation", capabilities, canHandleVariableCommunicationStepSize="true")
    _definitions(root, block, lambda types, name: add(types, "EnumerationType", name=name))
    reference = layout(block).reference
    _fmi3_variables(add(root, "ModelVariables"), block, reference)
    _fmi3_structure(add(root, "ModelStructure"), block, reference)
    return text(root)


def build_description(block: Block) -> bytes:
    """Return sources/buildDescription.xml of FMI 3.0: one C99 file and the mathematical library."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = add(root, "BuildConfiguration", modelIdentifier=block.name)
    files = add(configuration, "SourceFileSet", language="C99")
    add(files, "SourceFile", name=f"{block.name}.c")
    add(configuration, "Library", name="m")
    return text(root)


def terminals(block: Block) -> bytes | None:
    """Return terminalsAndIcons.xml of FMI 3.0, or None for a block without terminals."""
    if not block.terminals:
        return None
    root = Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    _terminals(root, block)
    return text(root)


def _terminals(parent: Element, block: Block) -> None:
    listed = add(parent, "Terminals")
    for name, members in block.terminals.items():
        kind = f"{TERMINAL_KINDS}.{name}"
        terminal = add(listed, "Terminal", name=name, matchingRule="bus", terminalKind=kind)
        for member, variable in members.items():
            names = {"variableName": variable, "memberName": member}
            add(terminal, "TerminalMemberVariable", names, variableKind="signal")


# Elements of both FMI versions


def _root(block: Block, version: str, token: dict[str, str]) -> Element:
    head = {"fmiVersion": version, "modelName": block.name, **token}
    return Element(
        "fmiModelDescription",
        head,
        description=block.description,
        generationTool=OWN_TOOL,
        variableNamingConvention="structured",
    )


def _definitions(root: Element, block: Block, add_type: Callable[[Element, str], Element]) -> None:
    """Add the units, enumerations, log categories and the default experiment.

    `add_type` adds an enumeration with the given name, and returns the parent of its items.
    """
    used = {unit for variable in block.variables.values() for unit in variable.units} | {"s"}
    used |= {
        unit for variable in block.differentiated for unit in map(rate, variable.units) if unit
    }
    definitions = add(root, "UnitDefinitions")
    for name in sorted(used):
        unit = add(definitions, "Unit", name=name)
        add(unit, "BaseUnit", {base: str(power) for base, power in UNITS[name].items()})
        if name in DISPLAY:
            display, factor = DISPLAY[name]
            add(unit, "DisplayUnit", name=display, factor=number(factor))
    enumerations = [v for v in block.variables.values() if v.kind == "enumeration"]
    types = add(root, "TypeDefinitions") if enumerations else root
    for variable in enumerations:
        items = add_type(types, _type_name(block, variable))
        for index, choice in enumerate(variable.choices):
            add(items, "Item", name=choice, value=str(index + 1))
    categories = add(root, "LogCategories")
    for name, description in LOG_CATEGORIES.items():
        add(categories, "Category", name=name, description=description)
    # FMPy doubles its output interval if the default experiment has more than 1000 steps. Therefore
    # the default experiment has 100 steps.
    times = {"startTime": "0", "stopTime": number(100 * block.default_step)}
    add(root, "DefaultExperiment", times, stepSize=number(block.default_step))


def _type_name(block: Block, variable: Variable) -> str:
    return f"{block.name}.{variable.name}"


def _common(block: Block, variable: Variable) -> dict[str, str]:
    """Return the attributes of a variable that have no unit and no value."""
    if variable.causality == "parameter":
        variability = "tunable" if variable.tunable else "fixed"
    elif block.is_sampled and variable.causality != "input":
        variability = "discrete"
    else:
        variability = "continuous"
    initial = {"initial": "exact" if block.has_start(variable) else "calculated"}
    return {
        "causality": variable.fmi_causality,
        "variability": variability,
        "description": variable.description,
        **(initial if variable.causality != "input" else {}),
    }


def _of_derivative(state: str) -> dict[str, str]:
    """Return the attributes of the derivative of a state that have no unit and no value."""
    return {
        "causality": "local",
        "variability": "continuous",
        "initial": "calculated",
        "description": f"Derivative of {state}",
    }


def _typed(block: Block, variable: Variable, elements: slice) -> dict[str, str]:
    """Return the start values of some elements, and the declared type."""
    found = {}
    if block.has_start(variable) and variable.start is not None:
        values = variable.start[elements]
        if variable.kind == "boolean":
            found["start"] = "true" if values[0] else "false"
        elif variable.kind == "enumeration":
            found["start"] = str(int(values[0]))
        else:
            found["start"] = " ".join(map(number, values))
    if variable.kind == "enumeration":
        found["declaredType"] = _type_name(block, variable)
    return found


def _unknowns(block: Block) -> list[tuple[str, list[str], dict[str, list[str]]]]:
    """Return the lists of ModelStructure: name, variables, and dependencies of their elements."""
    outputs = [variable for variable in block.having("output", "state") if not variable.local]
    computed = [variable.name for variable in outputs if not block.has_start(variable)]
    derivatives = [derivative_name(variable) for variable in block.differentiated]
    return [
        ("Output", [variable.name for variable in outputs], block.dependencies),
        ("Derivative", derivatives, block.dependencies),
        ("InitialUnknown", computed + derivatives, block.initial_dependencies),
    ]


def _elements(block: Block) -> dict[str, tuple[str, ...]]:
    """Return the names of the elements of each variable and of each derivative."""
    found = {variable.name: variable.element_names for variable in block.variables.values()}
    return found | {derivative_name(v): derivative_elements(v) for v in block.differentiated}


# FMI 2.0


def _fmi2_variables(parent: Element, block: Block, plan: Layout) -> dict[str, int]:
    """Add all scalar variables. Return the index (from 1) of each variable by name."""
    index: dict[str, int] = {}

    def scalar(
        name: str, reference: int, attributes: dict[str, str], kind: str, typed: dict[str, str]
    ) -> None:
        index[name] = len(index) + 1
        head = {"name": name, "valueReference": str(reference)}
        add(add(parent, "ScalarVariable", head | attributes), kind, typed)

    time = {"causality": "independent", "variability": "continuous"}
    scalar("time", 0, time | {"description": "Simulation time"}, "Real", {"unit": "s"})
    # Declared variables, with the start values and units of their elements.
    for variable in block.variables.values():
        kind = TYPES[variable.kind].replace("Float64", "Real")
        for i, name in enumerate(variable.element_names):
            typed = _typed(block, variable, slice(i, i + 1))
            if variable.kind == "real":
                typed["unit"] = variable.units[i]
            if variable.nominal != 1.0:
                typed["nominal"] = number(variable.nominal)
            first = plan.reference[variable.name]
            scalar(name, first + i, _common(block, variable), kind, typed)
    # Derivatives of the continuous states.
    for variable in block.differentiated:
        for i, state in enumerate(variable.element_names):
            unit = rate(variable.units[i])
            typed = ({"unit": unit} if unit else {}) | {"derivative": str(index[state])}
            first = plan.reference[derivative_name(variable)]
            scalar(f"der({state})", first + i, _of_derivative(state), "Real", typed)
    return index


def _fmi2_structure(parent: Element, block: Block, index: dict[str, int]) -> None:
    elements = _elements(block)
    for tag, variables, dependencies in _unknowns(block):
        names = [name for variable in variables for name in elements[variable]]
        listed = add(parent, f"{tag}s") if names else parent
        for name in sorted(names, key=index.__getitem__):
            depends = " ".join(str(index[known]) for known in dependencies[name])
            add(listed, "Unknown", index=str(index[name]), dependencies=depends)


# FMI 3.0


def _fmi3_variables(parent: Element, block: Block, reference: dict[str, int]) -> None:
    time = {"name": "time", "valueReference": "0", "causality": "independent"}
    rest = {"variability": "continuous", "unit": "s", "description": "Simulation time"}
    add(parent, "Float64", time | rest)
    # Declared variables.
    for variable in block.variables.values():
        attributes = {"name": variable.name, "valueReference": str(reference[variable.name])}
        attributes |= _common(block, variable) | _typed(block, variable, slice(None))
        if variable.nominal != 1.0:
            attributes["nominal"] = number(variable.nominal)
        if variable.causality != "parameter" and not block.is_sampled:
            attributes["intermediateUpdate"] = "true"
        # An array has only one unit in FMI 3.0. If the elements have different units (wrench or
        # twist), the units are in an annotation.
        if variable.kind == "real" and len(set(variable.units)) == 1:
            attributes["unit"] = variable.units[0]
        element = add(parent, TYPES[variable.kind], attributes)
        if len(set(variable.units)) > 1:
            annotation = add(add(element, "Annotations"), "Annotation", type=UNITS_ANNOTATION)
            annotation.text = " ".join(variable.units)
        if variable.is_array:
            add(element, "Dimension", start=str(variable.size))
    # Derivatives of the continuous states.
    for variable in block.differentiated:
        name = derivative_name(variable)
        unit = rate(variable.units[0]) if len(set(variable.units)) == 1 else None
        attributes = {"unit": unit} if unit else {}
        attributes |= {"name": name, "valueReference": str(reference[name])}
        attributes |= _of_derivative(variable.name)
        element = add(parent, "Float64", attributes, derivative=str(reference[variable.name]))
        if variable.is_array:
            add(element, "Dimension", start=str(variable.size))


def _fmi3_structure(parent: Element, block: Block, reference: dict[str, int]) -> None:
    elements = _elements(block)
    owner = {element: name for name, group in elements.items() for element in group}
    owner["time"] = "time"
    for tag, names, dependencies in _unknowns(block):
        for name in sorted(names, key=reference.__getitem__):
            depends = {
                reference[owner[known]]
                for element in elements[name]
                for known in dependencies[element]
            }
            add(
                parent,
                tag.replace("Derivative", "ContinuousStateDerivative"),
                valueReference=str(reference[name]),
                dependencies=" ".join(map(str, sorted(depends))),
            )
