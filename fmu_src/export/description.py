"""Block -> modelDescription.xml, FMI 2.0 and FMI 3.0."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree

from fmu_src.block import Block, Variable
from fmu_src.export.layout import Layout, derivative_elements, derivative_name, layout
from fmu_src.units import DISPLAY, UNITS

TOOL = "freeflyer-cosim"
UNITS_ANNOTATION = "org.freeflyer-cosim.units"
"""Type of the FMI 3.0 annotation that gives an array's units element by element."""


def text(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root) + b"\n"


def number(value: float) -> str:
    return repr(float(value))


def _units(root: ElementTree.Element, block: Block) -> None:
    used = sorted({unit for variable in block.variables.values() for unit in variable.units} | {"s"})
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for name in used:
        unit = ElementTree.SubElement(definitions, "Unit", name=name)
        ElementTree.SubElement(unit, "BaseUnit", {base: str(power) for base, power in UNITS[name].items()})
        if name in DISPLAY:
            display, factor = DISPLAY[name]
            ElementTree.SubElement(unit, "DisplayUnit", name=display, factor=number(factor))


def _log_categories(root: ElementTree.Element) -> None:
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", name="logStatusError", description="Calls and values that are not allowed")
    requirement = "The run has left what the equations hold for, such as a singular Jacobian"
    ElementTree.SubElement(categories, "Category", name="logRequirement", description=requirement)


def _experiment(root: ElementTree.Element, block: Block) -> None:
    # FMPy doubles its output interval beyond 1000 steps in the default experiment: keep below.
    step = block.default_step
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime=number(100 * step), stepSize=number(step))


def _type_name(block: Block, variable: Variable) -> str:
    return f"{block.name}.{variable.name}"


def _enumerations(block: Block) -> list[Variable]:
    return [variable for variable in block.variables.values() if variable.kind == "enumeration"]


def _causality(variable: Variable) -> str:
    if variable.causality == "state":
        return "local" if variable.local else "output"
    return variable.causality


def _variability(block: Block, variable: Variable) -> str:
    if variable.causality == "parameter":
        return "tunable" if variable.tunable else "fixed"
    if block.is_sampled and variable.causality in ("output", "state"):
        return "discrete"
    return "continuous"


def fmi2(block: Block, token: str) -> bytes:
    """modelDescription.xml of FMI 2.0: every element of an array is a variable of its own."""
    plan = layout(block)
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=block.name,
        guid=token,
        description=block.description,
        generationTool=TOOL,
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    if not block.is_sampled:
        ElementTree.SubElement(
            root, "ModelExchange", modelIdentifier=block.name, canGetAndSetFMUstate="true", canSerializeFMUstate="true"
        )
    ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=block.name,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    _units(root, block)
    if _enumerations(block):
        types = ElementTree.SubElement(root, "TypeDefinitions")
        for variable in _enumerations(block):
            items = ElementTree.SubElement(
                ElementTree.SubElement(types, "SimpleType", name=_type_name(block, variable)), "Enumeration"
            )
            for index, choice in enumerate(variable.choices):
                ElementTree.SubElement(items, "Item", name=choice, value=str(index + 1))
    _log_categories(root)
    _experiment(root, block)
    variables = ElementTree.SubElement(root, "ModelVariables")
    positions = _fmi2_variables(variables, block, plan)
    _fmi2_structure(ElementTree.SubElement(root, "ModelStructure"), block, positions)
    return text(root)


def _fmi2_variables(parent: ElementTree.Element, block: Block, plan: Layout) -> dict[str, int]:
    """Adds all scalars; gives the 1-based index of each by name."""
    index: dict[str, int] = {}

    def scalar(name: str, reference: int, **attributes: str) -> ElementTree.Element:
        index[name] = len(index) + 1
        return ElementTree.SubElement(parent, "ScalarVariable", {"name": name, "valueReference": str(reference), **attributes})

    element = scalar("time", 0, causality="independent", variability="continuous", description="Simulation time")
    ElementTree.SubElement(element, "Real", unit="s")
    for variable in block.variables.values():
        for i, name in enumerate(variable.element_names):
            attributes = {
                "causality": _causality(variable),
                "variability": _variability(block, variable),
                "description": variable.description,
            }
            typed: dict[str, str] = {}
            started = block.has_start(variable)
            if variable.causality != "input":
                attributes["initial"] = "exact" if started else "calculated"
            if started and variable.start is not None:
                value = variable.start[i]
                typed["start"] = number(value) if variable.kind == "real" else str(int(value))
            if variable.kind == "boolean" and "start" in typed:
                typed["start"] = "true" if variable.start is not None and variable.start[i] else "false"
            if variable.kind == "enumeration":
                typed["declaredType"] = _type_name(block, variable)
            if variable.kind == "real":
                typed["unit"] = variable.units[i]
            element = scalar(name, plan.reference[variable.name] + i, **attributes)
            ElementTree.SubElement(
                element, {"real": "Real", "boolean": "Boolean", "enumeration": "Enumeration"}[variable.kind], typed
            )
    for variable in [] if block.is_sampled else block.having("state"):
        for i, (name, state) in enumerate(zip(derivative_elements(variable), variable.element_names, strict=True)):
            element = scalar(
                name,
                plan.reference[derivative_name(variable)] + i,
                causality="local",
                variability="continuous",
                initial="calculated",
                description=f"Derivative of {state}",
            )
            ElementTree.SubElement(element, "Real", derivative=str(index[state]))
    return index


def _fmi2_structure(parent: ElementTree.Element, block: Block, index: dict[str, int]) -> None:
    outputs = [
        (variable, name)
        for variable in block.having("output", "state")
        if not variable.local
        for name in variable.element_names
    ]
    states = [] if block.is_sampled else [name for variable in block.having("state") for name in variable.element_names]
    # State-dependent unknowns may depend on every state; on inputs they depend as the equations say.
    listed = ElementTree.SubElement(parent, "Outputs") if outputs else None
    for _, name in sorted(outputs, key=lambda pair: index[pair[1]]):
        depends = sorted(index[other] for other in [*block.dependencies[name], *states])
        assert listed is not None
        ElementTree.SubElement(listed, "Unknown", index=str(index[name]), dependencies=" ".join(map(str, depends)))
    if states:
        derivatives = ElementTree.SubElement(parent, "Derivatives")
        for name in states:
            ElementTree.SubElement(derivatives, "Unknown", index=str(index[f"der({name})"]))
    computed = [variable for variable in block.having("output", "state") if not (variable.local or block.has_start(variable))]
    unknowns = [name for variable in computed for name in variable.element_names] + [f"der({name})" for name in states]
    if unknowns:
        initial = ElementTree.SubElement(parent, "InitialUnknowns")
        for name in sorted(unknowns, key=index.__getitem__):
            ElementTree.SubElement(initial, "Unknown", index=str(index[name]))


def fmi3(block: Block, token: str) -> bytes:
    """modelDescription.xml of FMI 3.0: arrays are arrays."""
    plan = layout(block)
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=block.name,
        instantiationToken=token,
        description=block.description,
        generationTool=TOOL,
        variableNamingConvention="structured",
    )
    if not block.is_sampled:
        ElementTree.SubElement(
            root, "ModelExchange", modelIdentifier=block.name, canGetAndSetFMUState="true", canSerializeFMUState="true"
        )
    ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=block.name,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
    )
    _units(root, block)
    if _enumerations(block):
        types = ElementTree.SubElement(root, "TypeDefinitions")
        for variable in _enumerations(block):
            items = ElementTree.SubElement(types, "EnumerationType", name=_type_name(block, variable))
            for index, choice in enumerate(variable.choices):
                ElementTree.SubElement(items, "Item", name=choice, value=str(index + 1))
    _log_categories(root)
    _experiment(root, block)
    _fmi3_variables(ElementTree.SubElement(root, "ModelVariables"), block, plan)
    _fmi3_structure(ElementTree.SubElement(root, "ModelStructure"), block, plan)
    return text(root)


def _fmi3_variables(parent: ElementTree.Element, block: Block, plan: Layout) -> None:
    ElementTree.SubElement(
        parent, "Float64", name="time", valueReference="0", causality="independent", variability="continuous", unit="s",
        description="Simulation time",
    )  # fmt: skip
    for variable in block.variables.values():
        attributes = {
            "name": variable.name,
            "valueReference": str(plan.reference[variable.name]),
            "causality": _causality(variable),
            "variability": _variability(block, variable),
            "description": variable.description,
        }
        started = block.has_start(variable)
        if variable.causality != "input":
            attributes["initial"] = "exact" if started else "calculated"
        if started and variable.start is not None:
            values = variable.start
            if variable.kind == "boolean":
                attributes["start"] = "true" if values[0] else "false"
            elif variable.kind == "enumeration":
                attributes["start"] = str(int(values[0]))
            else:
                attributes["start"] = " ".join(number(value) for value in values)
        if variable.kind == "enumeration":
            attributes["declaredType"] = _type_name(block, variable)
        # FMI 3.0 has one unit for a whole array; a wrench or twist mixes two and tells them in an annotation.
        if variable.kind == "real" and len(set(variable.units)) == 1:
            attributes["unit"] = variable.units[0]
        tag = {"real": "Float64", "boolean": "Boolean", "enumeration": "Enumeration"}[variable.kind]
        element = ElementTree.SubElement(parent, tag, attributes)
        if len(set(variable.units)) > 1:
            annotations = ElementTree.SubElement(element, "Annotations")
            ElementTree.SubElement(annotations, "Annotation", type=UNITS_ANNOTATION).text = " ".join(variable.units)
        if variable.is_array:
            ElementTree.SubElement(element, "Dimension", start=str(variable.size))
    for variable in [] if block.is_sampled else block.having("state"):
        element = ElementTree.SubElement(
            parent,
            "Float64",
            name=derivative_name(variable),
            valueReference=str(plan.reference[derivative_name(variable)]),
            causality="local",
            variability="continuous",
            initial="calculated",
            description=f"Derivative of {variable.name}",
            derivative=str(plan.reference[variable.name]),
        )
        if variable.is_array:
            ElementTree.SubElement(element, "Dimension", start=str(variable.size))


def _fmi3_structure(parent: ElementTree.Element, block: Block, plan: Layout) -> None:
    states = [] if block.is_sampled else block.having("state")
    outputs = [variable for variable in block.having("output", "state") if not variable.local]
    owner = {name: variable.name for variable in block.having("input") for name in variable.element_names} | {"time": "time"}

    def references(names: Iterable[str]) -> str:
        return " ".join(str(reference) for reference in sorted({plan.reference[name] for name in names}))

    for variable in sorted(outputs, key=lambda variable: plan.reference[variable.name]):
        depends = {owner[name] for element in variable.element_names for name in block.dependencies[element]}
        ElementTree.SubElement(
            parent,
            "Output",
            valueReference=str(plan.reference[variable.name]),
            dependencies=references([*depends, *(state.name for state in states)]),
        )
    for variable in states:
        ElementTree.SubElement(
            parent, "ContinuousStateDerivative", valueReference=str(plan.reference[derivative_name(variable)])
        )
    unknowns = [
        variable.name for variable in block.having("output", "state") if not (variable.local or block.has_start(variable))
    ]
    unknowns += [derivative_name(variable) for variable in states]
    for name in sorted(unknowns, key=plan.reference.__getitem__):
        ElementTree.SubElement(parent, "InitialUnknown", valueReference=str(plan.reference[name]))
