"""libcosim (Open Simulation Platform) through `libcosimpy`: FMI 2.0.

Its exchange rule is Rule(rounds=number of components, late=True) of reference_loops.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from libcosimpy._internal import get_last_error_message
from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave
from slaves import (
    Array,
    Connection,
    StartValues,
    Variable,
    elements,
    split,
    ticks,
    times,
    variables_of,
    with_integers,
)

OSP = "http://opensimulationplatform.com/MSMI/OSPSystemStructure"


class LibcosimError(Exception):
    """An error message of libcosim."""


def checked(done: bool, what: str) -> None:
    if not done:
        raise LibcosimError(f"{what}: {get_last_error_message()}")


def run(
    fmus: Mapping[str, Path],
    connections: Sequence[Connection],
    start_values: StartValues,
    steps: Mapping[str, float],
    stop: float,
    recorded: Sequence[str],
) -> dict[str, Array]:
    size, _, count = ticks(steps, stop)
    log_output_level(CosimLogLevel.WARNING)
    with tempfile.TemporaryDirectory() as folder:
        fmus = with_integers(fmus, start_values, Path(folder))
        variables = variables_of(fmus)
        if len(set(steps.values())) == 1:
            execution = _in_memory(fmus, variables, connections, start_values, size)
        else:  # libcosimpy's calls give all slaves the same step
            path = Path(folder) / "OspSystemStructure.xml"
            write_system_structure(path, fmus, variables, connections, start_values, steps)
            execution = CosimExecution.from_osp_config_file(str(path))
        return _simulate(execution, variables, recorded, size, count)


def run_ssp(
    path: Path, fmus: Mapping[str, Path], size: float, stop: float, recorded: Sequence[str]
) -> dict[str, Array]:
    """Run an SSP file; its OSP annotations contain base step and steps."""
    return _simulate(
        CosimExecution.from_ssp_file(str(path)),
        variables_of(fmus),
        recorded,
        size,
        round(stop / size),
    )


def _in_memory(
    fmus: Mapping[str, Path],
    variables: Mapping[str, Mapping[str, Variable]],
    connections: Sequence[Connection],
    start_values: StartValues,
    size: float,
) -> CosimExecution:
    execution = CosimExecution.from_step_size(round(size * 1e9))
    index = {
        name: execution.add_local_slave(CosimLocalSlave(str(path), name))
        for name, path in fmus.items()
    }
    for name, number in index.items():
        checked(number >= 0, f"adding {name}")
    for name, values in start_values.items():
        for variable, value in values.items():
            found = variables[name][variable]
            put = {
                "Boolean": execution.boolean_initial_value,
                "Integer": execution.integer_initial_value,
            }.get(found.kind, execution.real_initial_value)
            for reference, item in zip(found.references, elements(value, found.size), strict=True):
                checked(put(index[name], reference, item), f"setting {name}.{variable}")
    for source, target in connections:
        (start, output), (end, input_) = split(source), split(target)
        pairs = zip(
            variables[start][output].references, variables[end][input_].references, strict=True
        )
        for a, b in pairs:
            checked(
                execution.connect_real_variables(index[start], a, index[end], b) == 0,
                f"connecting {source} to {target}",
            )
    return execution


def _simulate(
    execution: CosimExecution,
    variables: Mapping[str, Mapping[str, Variable]],
    recorded: Sequence[str],
    size: float,
    count: int,
) -> dict[str, Array]:
    observer = CosimObserver.create_time_series(count + 2)
    checked(execution.add_observer(observer), "adding an observer")
    places = {}
    for signal in recorded:
        component, variable = split(signal)
        number = execution.slave_index_from_instance_name(component)
        places[signal] = [
            (number, reference) for reference in variables[component][variable].references
        ]
        for number, reference in places[signal]:
            checked(
                observer.start_time_series(number, reference, CosimVariableType.REAL),
                f"observing {signal}",
            )
    checked(execution.step(count), "stepping")
    record = {"time": times(1, count, size)}
    for signal, place in places.items():
        columns = [
            observer.time_series_real_samples(*where, from_step=1, sample_count=count)
            for where in place
        ]
        # A slow slave is observed only at the ends of its steps; the values between are held.
        held = np.searchsorted(columns[0][1], np.arange(1, count + 1), side="right") - 1
        values = np.array([column[2] for column in columns]).T
        record[signal] = np.where(held[:, None] < 0, np.nan, values[held])
    return record


def write_system_structure(
    path: Path,
    fmus: Mapping[str, Path],
    variables: Mapping[str, Mapping[str, Variable]],
    connections: Sequence[Connection],
    start_values: StartValues,
    steps: Mapping[str, float],
) -> None:
    """Write OspSystemStructure.xml, where each slave can have another step."""
    root = ElementTree.Element("OspSystemStructure", {"xmlns": OSP, "version": "0.1"})
    for tag, text in (("BaseStepSize", repr(min(steps.values()))), ("Algorithm", "fixedStep")):
        ElementTree.SubElement(root, tag).text = text
    simulators = ElementTree.SubElement(root, "Simulators")
    for name, fmu in fmus.items():
        attributes = {"name": name, "source": str(fmu), "stepSize": repr(steps[name])}
        initial = ElementTree.SubElement(
            ElementTree.SubElement(simulators, "Simulator", attributes), "InitialValues"
        )
        for variable, value in start_values.get(name, {}).items():
            found = variables[name][variable]
            for element, item in zip(found.names, elements(value, found.size), strict=True):
                where = ElementTree.SubElement(initial, "InitialValue", {"variable": element})
                text = str(item).lower() if found.kind == "Boolean" else repr(item)
                ElementTree.SubElement(where, found.kind, {"value": text})
    wires = ElementTree.SubElement(root, "Connections")
    for source, target in connections:
        (start, output), (end, input_) = split(source), split(target)
        for a, b in zip(variables[start][output].names, variables[end][input_].names, strict=True):
            wire = ElementTree.SubElement(wires, "VariableConnection")
            ElementTree.SubElement(wire, "Variable", {"simulator": start, "name": a})
            ElementTree.SubElement(wire, "Variable", {"simulator": end, "name": b})
    ElementTree.ElementTree(root).write(path, "utf-8", xml_declaration=True)
