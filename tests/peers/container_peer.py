"""An FMU container of `fmu-manipulation-toolbox`, run by FMPy: FMI 2.0 and FMI 3.0.

Its exchange rule is Rule(sequential, initial_order=..., late=True) of reference_loops. Components
with a slower step are first.
"""

from __future__ import annotations

import logging
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import fmpy
import numpy as np
from fmu_manipulation_toolbox.assembly import AssemblyNode
from slaves import (
    Array,
    Connection,
    Slave,
    StartValues,
    elements,
    split,
    ticks,
    times,
    variables_of,
)

INNER = "slow"
OUT = "out"
"""Prefix of the container's outputs; without it their names would collide with its locals."""


def run(
    fmus: Mapping[str, Path],
    connections: Sequence[Connection],
    start_values: StartValues,
    steps: Mapping[str, float],
    stop: float,
    recorded: Sequence[str],
    *,
    sequential: bool = False,
) -> dict[str, Array]:
    """Run the loop; `sequential` steps one component after the other in the order of `fmus`."""
    size, _, count = ticks(steps, stop)
    with tempfile.TemporaryDirectory() as folder:
        path, first = build(
            Path(folder), fmus, connections, start_values, steps, recorded, sequential=sequential
        )
        return run_container(path, first, recorded, size, count)


def build(
    folder: Path,
    fmus: Mapping[str, Path],
    connections: Sequence[Connection],
    start_values: StartValues,
    steps: Mapping[str, float],
    recorded: Sequence[str],
    *,
    sequential: bool,
) -> tuple[Path, dict[str, Sequence[float]]]:
    """Build one container; components of each slower step are in a nested container.

    An FMU that is initialised before its sources gets zeros instead of its own start values. A loop
    always has such an FMU. Therefore the start values of connected inputs are returned, too, by the
    names of the container's locals that contain the sources' values.
    """
    logging.getLogger("fmu_manipulation_toolbox").setLevel(logging.ERROR)
    variables = variables_of(fmus)
    for name, path in fmus.items():
        shutil.copy(path, folder / f"{name}.fmu")
    version = (
        2
        if fmpy.read_model_description(str(next(iter(fmus.values())))).fmiVersion.startswith("2")
        else 3
    )
    automatic = {"auto_link": False, "auto_input": False, "auto_output": False}
    root = AssemblyNode(
        "loop.fmu", step_size=min(steps.values()), sequential=sequential, **automatic
    )
    # A node for each step.
    nodes, place = {root.step_size: root}, {}
    for name in fmus:
        step = steps[name]
        if step not in nodes:
            nodes[step] = AssemblyNode(
                f"{INNER}{len(nodes)}.fmu", step_size=step, sequential=sequential, **automatic
            )
            root.add_sub_node(nodes[step])
        nodes[step].add_fmu(f"{name}.fmu")
        place[name] = nodes[step]

    def outer(signal: str, element: str) -> tuple[str, str]:
        """Return FMU and port of an element in the outer container."""
        name = split(signal)[0]
        return (
            (f"{name}.fmu", element)
            if place[name] is root
            else (place[name].name, f"{name}.{element}")
        )

    def named(signal: str) -> tuple[str, ...]:
        return variables[split(signal)[0]][split(signal)[1]].names

    # Connected and recorded signals of a nested container become its inputs and outputs.
    for signal in {signal for pair in connections for signal in pair} | set(recorded):
        name, variable = split(signal)
        is_input = any(signal == target for _, target in connections)
        for element in variables[name][variable].names if place[name] is not root else ():
            if is_input:
                place[name].add_input(f"{name}.{element}", f"{name}.fmu", element)
            else:
                place[name].add_output(f"{name}.fmu", element, f"{name}.{element}")
    # Connections, outputs and start values.
    first: dict[str, Sequence[float]] = {}
    for source, target in connections:
        start = variables[split(target)[0]][split(target)[1]].start
        file, port = outer(source, split(source)[1])
        if start:
            first[f"{Path(file).stem}.{port}"] = start
        for a, b in zip(named(source), named(target), strict=True):
            root.add_link(*outer(source, a), *outer(target, b))
    for signal in recorded:
        for element in named(signal):
            root.add_output(*outer(signal, element), f"{OUT}.{split(signal)[0]}.{element}")
    for name, values in start_values.items():
        for variable, value in values.items():
            found = variables[name][variable]
            texts = [
                str(x).lower() if isinstance(x, bool) else repr(x)
                for x in elements(value, found.size)
            ]
            for element, text in zip(
                found.names, texts if len(found.names) > 1 else [" ".join(texts)], strict=True
            ):
                place[name].add_start_value(f"{name}.fmu", element, text)
    root.make_fmu(folder, fmi_version=version)
    return folder / "loop.fmu", first


def run_container(
    path: Path,
    first: Mapping[str, Sequence[float]],
    recorded: Sequence[str],
    size: float,
    count: int,
) -> dict[str, Array]:
    # An FMI 3.0 container with arrays (version 2.0) does not conform to the schema: no validation.
    container = Slave("loop", path, validate=False)
    try:
        container.enter_initialization(first)
        container.exit_initialization()
        record = {
            signal: np.empty((count + 1, container.variables[f"{OUT}.{signal}"].size))
            for signal in recorded
        }
        record["time"] = times(0, count, size)
        for k in range(count + 1):
            for signal in recorded:
                record[signal][k] = container.get(f"{OUT}.{signal}")
            if k < count:
                container.step(k * size, size)
        return record
    finally:
        container.close()
