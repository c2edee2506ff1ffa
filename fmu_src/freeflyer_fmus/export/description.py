"""Generation of modelDescription.xml from a block, for FMI 2.0 and FMI 3.0."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from xml.etree import ElementTree

from freeflyer_fmus.blocks.block import Block, Variable
from freeflyer_fmus.export.layout import Layout, derivative_elements, derivative_name, layout
from freeflyer_fmus.units import DISPLAY, UNITS, rate

TOOL = "freeflyer-cosim"
UNITS_ANNOTATION = "org.freeflyer-cosim.units"
"""Type of the FMI 3.0 annotation that contains the units of an array, one unit per element."""
TERMINAL_KINDS = "org.freeflyer-cosim"


def text(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root) + b"\n"


def number(value: float) -> str:
    return repr(float(value))


def _units(root: ElementTree.Element, block: Block) -> None:
    used = {unit for variable in block.variables.values() for unit in variable.units} | {"s"}
    used |= {
        unit for variable in _differentiated(block) for unit in map(rate, variable.units) if unit
    }
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for name in sorted(used):
        unit = ElementTree.SubElement(definitions, "Unit", name=name)
        ElementTree.SubElement(
            unit, "BaseUnit", {base: str(power) for base, power in UNITS[name].items()}
        )
        if name in DISPLAY:
            display, factor = DISPLAY[name]
            ElementTree.SubElement(unit, "DisplayUnit", name=display, factor=number(factor))


def _log_categories(root: ElementTree.Element) -> None:
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(
        categories,
        "Category",
        name="logStatusError",
        description="Rejected calls and values",
    )
    requirement = "Violated requirements of the equations, for example a singular Jacobian"
    ElementTree.SubElement(categories, "Category", name="logRequirement", description=requirement)


def _experiment(root: ElementTree.Element, block: Block) -> None:
    # FMPy doubles its output interval if the default experiment has more than 1000 steps. Therefore
    # the default experiment has 100 steps.
    step = block.default_step
    ElementTree.SubElement(
        root, "DefaultExperiment", startTime="0", stopTime=number(100 * step), stepSize=number(step)
    )


def _type_name(block: Block, variable: Variable) -> str:
    return f"{block.name}.{variable.name}"


def _differentiated(block: Block) -> list[Variable]:
    return [] if block.is_sampled else block.having("state")


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


def fmi2(block: Block, token: str, sources: Sequence[str] = ()) -> bytes:
    """Return modelDescription.xml of FMI 2.0, in which every array element is a variable.

    `sources` are the names of the C files that the FMU contains.
    """
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
    common = {
        "modelIdentifier": block.name,
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "canNotUseMemoryManagementFunctions": "true",
        "providesDirectionalDerivative": "true",
    }
    # Interface types. A sampled block has no model exchange.
    interfaces = []
    if not block.is_sampled:
        interfaces.append(
            ElementTree.SubElement(
                root, "ModelExchange", common, completedIntegratorStepNotNeeded="true"
            )
        )
    interfaces.append(
        ElementTree.SubElement(
            root, "CoSimulation", common, canHandleVariableCommunicationStepSize="true"
        )
    )
    for interface in interfaces if sources else []:
        listed = ElementTree.SubElement(interface, "SourceFiles")
        for name in sources:
            ElementTree.SubElement(listed, "File", name=name)
    # Units, enumerations, log categories and default experiment.
    _units(root, block)
    if _enumerations(block):
        types = ElementTree.SubElement(root, "TypeDefinitions")
        for variable in _enumerations(block):
            items = ElementTree.SubElement(
                ElementTree.SubElement(types, "SimpleType", name=_type_name(block, variable)),
                "Enumeration",
            )
            for index, choice in enumerate(variable.choices):
                ElementTree.SubElement(items, "Item", name=choice, value=str(index + 1))
    _log_categories(root)
    _experiment(root, block)
    # FMI 2.0 does not define terminals. Therefore the terminals are in a vendor annotation.
    if block.terminals:
        annotations = ElementTree.SubElement(root, "VendorAnnotations")
        _terminals(ElementTree.SubElement(annotations, "Tool", name=TERMINAL_KINDS), block)
    variables = ElementTree.SubElement(root, "ModelVariables")
    positions = _fmi2_variables(variables, block, plan)
    _fmi2_structure(ElementTree.SubElement(root, "ModelStructure"), block, positions)
    return text(root)


def build_description(block: Block) -> bytes:
    """Return sources/buildDescription.xml of FMI 3.0: one C99 file and the mathematical library."""
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=block.name)
    files = ElementTree.SubElement(configuration, "SourceFileSet", language="C99")
    ElementTree.SubElement(files, "SourceFile", name=f"{block.name}.c")
    ElementTree.SubElement(configuration, "Library", name="m")
    return text(root)


def _fmi2_variables(parent: ElementTree.Element, block: Block, plan: Layout) -> dict[str, int]:
    """Add all scalar variables. Return the index (from 1) of each variable by name."""
    index: dict[str, int] = {}

    def scalar(name: str, reference: int, **attributes: str) -> ElementTree.Element:
        index[name] = len(index) + 1
        return ElementTree.SubElement(
            parent, "ScalarVariable", {"name": name, "valueReference": str(reference), **attributes}
        )

    element = scalar(
        "time", 0, causality="independent", variability="continuous", description="Simulation time"
    )
    ElementTree.SubElement(element, "Real", unit="s")
    # Declared variables, with the start values and units of their elements.
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
                typed["start"] = (
                    "true" if variable.start is not None and variable.start[i] else "false"
                )
            if variable.kind == "enumeration":
                typed["declaredType"] = _type_name(block, variable)
            if variable.kind == "real":
                typed["unit"] = variable.units[i]
            if variable.nominal != 1.0:
                typed["nominal"] = number(variable.nominal)
            element = scalar(name, plan.reference[variable.name] + i, **attributes)
            ElementTree.SubElement(
                element,
                {"real": "Real", "boolean": "Boolean", "enumeration": "Enumeration"}[variable.kind],
                typed,
            )
    # Derivatives of the continuous states.
    for variable in _differentiated(block):
        for i, (name, state) in enumerate(
            zip(derivative_elements(variable), variable.element_names, strict=True)
        ):
            element = scalar(
                name,
                plan.reference[derivative_name(variable)] + i,
                causality="local",
                variability="continuous",
                initial="calculated",
                description=f"Derivative of {state}",
            )
            unit = rate(variable.units[i])
            ElementTree.SubElement(
                element, "Real", {"unit": unit} if unit else {}, derivative=str(index[state])
            )
    return index


def _fmi2_structure(parent: ElementTree.Element, block: Block, index: dict[str, int]) -> None:
    def unknowns(tag: str, names: Iterable[str], dependencies: dict[str, list[str]]) -> None:
        ordered = sorted(names, key=index.__getitem__)
        listed = ElementTree.SubElement(parent, tag) if ordered else None
        for name in ordered:
            depends = " ".join(str(index[known]) for known in dependencies[name])
            assert listed is not None
            ElementTree.SubElement(listed, "Unknown", index=str(index[name]), dependencies=depends)

    outputs = [v for v in block.having("output", "state") if not v.local]
    derivatives = [
        name for variable in _differentiated(block) for name in derivative_elements(variable)
    ]
    computed = [
        name
        for variable in outputs
        if not block.has_start(variable)
        for name in variable.element_names
    ]
    unknowns(
        "Outputs",
        [name for variable in outputs for name in variable.element_names],
        block.dependencies,
    )
    unknowns("Derivatives", derivatives, block.dependencies)
    unknowns("InitialUnknowns", computed + derivatives, block.initial_dependencies)


def fmi3(block: Block, token: str) -> bytes:
    """Return modelDescription.xml of FMI 3.0, in which an array is one variable."""
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
    # Interface types. A sampled block has no model exchange.
    common = {
        "modelIdentifier": block.name,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true",
        "providesAdjointDerivatives": "true",
    }
    # A continuous block divides a communication step into inner steps (integration steps). Between
    # two inner steps, it supports intermediate update and early return.
    inner = (
        {}
        if block.is_sampled
        else {"providesIntermediateUpdate": "true", "canReturnEarlyAfterIntermediateUpdate": "true"}
    )
    if not block.is_sampled:
        ElementTree.SubElement(root, "ModelExchange", common, needsCompletedIntegratorStep="false")
    ElementTree.SubElement(
        root, "CoSimulation", common | inner, canHandleVariableCommunicationStepSize="true"
    )
    # Units, enumerations, log categories and default experiment.
    _units(root, block)
    if _enumerations(block):
        types = ElementTree.SubElement(root, "TypeDefinitions")
        for variable in _enumerations(block):
            items = ElementTree.SubElement(
                types, "EnumerationType", name=_type_name(block, variable)
            )
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
    # Declared variables.
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
        if variable.nominal != 1.0:
            attributes["nominal"] = number(variable.nominal)
        if variable.causality != "parameter" and not block.is_sampled:
            attributes["intermediateUpdate"] = "true"
        # An array has only one unit in FMI 3.0. If the elements have different units (wrench or
        # twist), the units are in an annotation.
        if variable.kind == "real" and len(set(variable.units)) == 1:
            attributes["unit"] = variable.units[0]
        tag = {"real": "Float64", "boolean": "Boolean", "enumeration": "Enumeration"}[variable.kind]
        element = ElementTree.SubElement(parent, tag, attributes)
        if len(set(variable.units)) > 1:
            annotations = ElementTree.SubElement(element, "Annotations")
            ElementTree.SubElement(
                annotations, "Annotation", type=UNITS_ANNOTATION
            ).text = " ".join(variable.units)
        if variable.is_array:
            ElementTree.SubElement(element, "Dimension", start=str(variable.size))
    # Derivatives of the continuous states.
    for variable in _differentiated(block):
        unit = rate(variable.units[0]) if len(set(variable.units)) == 1 else None
        element = ElementTree.SubElement(
            parent,
            "Float64",
            {"unit": unit} if unit else {},
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
    owner = {
        name: variable.name
        for variable in block.variables.values()
        for name in variable.element_names
    }
    owner |= {
        name: derivative_name(variable)
        for variable in _differentiated(block)
        for name in derivative_elements(variable)
    }
    elements: dict[str, list[str]] = {}
    for element, name in owner.items():
        elements.setdefault(name, []).append(element)
    owner["time"] = "time"

    def unknowns(tag: str, names: Iterable[str], dependencies: dict[str, list[str]]) -> None:
        for name in sorted(names, key=plan.reference.__getitem__):
            depends = {
                plan.reference[owner[known]]
                for element in elements[name]
                for known in dependencies[element]
            }
            ElementTree.SubElement(
                parent,
                tag,
                valueReference=str(plan.reference[name]),
                dependencies=" ".join(map(str, sorted(depends))),
            )

    outputs = [variable for variable in block.having("output", "state") if not variable.local]
    derivatives = [derivative_name(variable) for variable in _differentiated(block)]
    computed = [variable.name for variable in outputs if not block.has_start(variable)]
    unknowns("Output", [variable.name for variable in outputs], block.dependencies)
    unknowns("ContinuousStateDerivative", derivatives, block.dependencies)
    unknowns("InitialUnknown", computed + derivatives, block.initial_dependencies)


def terminals(block: Block) -> bytes | None:
    """Return terminalsAndIcons.xml of FMI 3.0, or None for a block without terminals."""
    if not block.terminals:
        return None
    root = ElementTree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    _terminals(root, block)
    return text(root)


def _terminals(parent: ElementTree.Element, block: Block) -> None:
    listed = ElementTree.SubElement(parent, "Terminals")
    for name, members in block.terminals.items():
        terminal = ElementTree.SubElement(
            listed,
            "Terminal",
            name=name,
            matchingRule="bus",
            terminalKind=f"{TERMINAL_KINDS}.{name}",
        )
        for member, variable in members.items():
            ElementTree.SubElement(
                terminal,
                "TerminalMemberVariable",
                variableName=variable,
                memberName=member,
                variableKind="signal",
            )
