"""Generation of a Markdown page of all FMU variables from the declarations of the blocks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from freeflyer_fmus.blocks.block import Block, Variable

HEAD = """# FMU variables

Generated from the block declarations by `python -m freeflyer_fmus.export.documentation`. The start values are valid for the default robot.
In FMI 2.0 the elements of an array are `name[1]` ... `name[n]`. "Assumed" marks values that the paper does not give.
An input marked "delayed" gets the value that its source had before the present [instant](scenarios.md#order-of-evaluation).
"""


def page(blocks: Iterable[Block]) -> str:
    """Return the Markdown page of these blocks."""
    return HEAD + "".join(_section(block) for block in blocks)


def _section(block: Block) -> str:
    kind = (
        f"sampled at `{block.period}`"
        if block.is_sampled
        else "continuous: co-simulation and model exchange"
    )
    lines = [f"\n## {block.name}\n\n{block.description} ({kind}).\n"]
    for title, causality in (
        ("Parameters", "parameter"),
        ("Inputs", "input"),
        ("States (visible as outputs)", "state"),
        ("Outputs", "output"),
    ):
        variables = [variable for variable in block.having(causality) if not variable.local]
        if variables:
            lines += [
                f"\n{title}:\n\n| name | size | unit | start | description |\n|---|---|---|---|---|\n"
            ]
            lines += [_row(variable) for variable in variables]
    return "".join(lines)


def _row(variable: Variable) -> str:
    units = list(dict.fromkeys(variable.units))
    start = "" if variable.start is None else _values(variable)
    note = ", tunable" if variable.tunable else ""
    return f"| `{variable.name}` | {variable.size} | {', '.join(units)} | {start} | {variable.description}{note} |\n"


def _values(variable: Variable) -> str:
    assert variable.start is not None
    if variable.kind == "boolean":
        return str(bool(variable.start[0])).lower()
    if variable.kind == "enumeration":
        return f"{variable.choices[int(variable.start[0]) - 1]} (of {', '.join(variable.choices)})"
    values = [f"{0.0 if abs(value) < 1e-15 else value:.6g}" for value in variable.start]
    return (
        values[0] if len(set(values)) == 1 and not np.isnan(variable.start[0]) else " ".join(values)
    )


if __name__ == "__main__":
    from freeflyer_fmus.blocks.shipped import BLOCKS
    from freeflyer_fmus.robot.urdf import load_robot_file

    robot = load_robot_file()
    print(page(make(robot) for make in BLOCKS.values()), end="")
