"""Layout of a block's values in one flat vector, the value vector.

The index of a value is its value reference in FMI 2.0 and FMI 3.0. The order is time, parameters,
inputs, states, outputs, derivatives. Only a continuous block has derivatives. In FMI 3.0 the value
reference of an array is the index of its first element.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from freeflyer_fmus.blocks.block import Block, Variable

Access = Literal["read_only", "fixed", "tunable", "input", "start"]


@dataclass(frozen=True)
class Value:
    """Entry of the value vector: one element of a variable.

    `element` is the name of the element. `kind` is the kind of the variable: real, boolean or
    enumeration. `access` states when the value can be set. `maximum` is the number of options of an
    enumeration, and 0 for other kinds. At the first element of a variable, `extent` is the size of
    the variable. At all other elements, `extent` is 0.
    """

    element: str
    kind: str
    access: Access
    maximum: int
    extent: int


@dataclass(frozen=True)
class Layout:
    """Layout of all values of a block.

    `values` and their `start` values are in the order of the value references. `nominal` contains
    the nominal values of the states. `ranges` contains (first value reference, count) of the
    parameters, inputs, states, outputs and derivatives. `reference` contains the value reference of
    each variable's first element.
    """

    values: tuple[Value, ...]
    start: tuple[float, ...]
    nominal: tuple[float, ...]
    ranges: dict[str, tuple[int, int]]
    reference: dict[str, int]


def derivative_name(variable: Variable) -> str:
    return f"der({variable.name})"


def derivative_elements(variable: Variable) -> tuple[str, ...]:
    """Return the names of the derivative's elements in FMI 2.0's structured naming.

    The index is inside the parentheses, as in der(x[1]).
    """
    return tuple(f"der({element})" for element in variable.element_names)


def layout(block: Block) -> Layout:
    """Assign a value reference to every element of the block's variables and derivatives."""
    values = [Value("time", "real", "read_only", 0, 1)]
    start, ranges, reference = [0.0], {}, {"time": 0}
    access: dict[str, Access] = {"input": "input", "state": "start", "output": "read_only"}
    for name, causality in (
        ("parameters", "parameter"),
        ("inputs", "input"),
        ("states", "state"),
        ("outputs", "output"),
    ):
        first = len(values)
        for variable in block.having(causality):
            reference[variable.name] = len(values)
            how: Access = access.get(causality) or ("tunable" if variable.tunable else "fixed")
            if not block.has_start(variable):
                how = "read_only"
            for index, element in enumerate(variable.element_names):
                extent = variable.size if index == 0 else 0
                values.append(Value(element, variable.kind, how, len(variable.choices), extent))
                start.append(0.0 if variable.start is None else float(variable.start[index]))
        ranges[name] = (first, len(values) - first)
    first = len(values)
    for variable in block.differentiated:
        reference[derivative_name(variable)] = len(values)
        for index, element in enumerate(derivative_elements(variable)):
            values.append(
                Value(element, "real", "read_only", 0, variable.size if index == 0 else 0)
            )
            start.append(0.0)
    ranges["derivatives"] = (first, len(values) - first)
    nominal = tuple(
        variable.nominal for variable in block.having("state") for _ in range(variable.size)
    )
    return Layout(tuple(values), tuple(start), nominal, ranges, reference)
