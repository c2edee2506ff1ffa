"""Evaluation of the sweep `paper_sensitivity`: how firmly the paper's statements hold.

The sweep changes one assumption at a time. Each design is run in the three cases of
`criteria.RUNS`. The criteria of all statements are then checked for each design.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.output_file import write_text
from freeflyer.paper import criteria
from freeflyer.paper.criteria import Criterion
from freeflyer.scenario.experiment import Result

Row = Mapping[str, Any]
FILE = "sensitivity.md"
NEAR = (0.9, 0.95, 1.05, 1.1)
"""Factors of an assumption that must not change any statement."""


class Sensitivity:
    """See `freeflyer.analysis.sweep.evaluation.Evaluation`."""

    signals = criteria.SIGNALS
    columns = criteria.columns()

    def measure(self, result: Result) -> Mapping[str, float]:
        return criteria.measure(result)

    def report(self, rows: Sequence[Row], axes: Sequence[str], folder: Path) -> RenderableType:
        designs = judged_designs(rows)
        header, lines = verdicts(designs, axes)
        markdown = [header, ["---"] * len(header), *lines]
        closing = summary(designs, axes)
        write_text(
            folder / FILE,
            "\n".join(f"| {' | '.join(line)} |" for line in markdown) + f"\n\n{closing}\n",
        )
        table = Table()
        table.add_column("assumption", overflow="fold", ratio=1)
        table.add_column("factors at which statements fail (their figures)", ratio=1)
        for name, *cells in lines:
            failed = [
                f"{factor} ({cell})"
                for factor, cell in zip(header[1:], cells, strict=True)
                if cell not in ("", "-")
            ]
            table.add_row(name.strip("`"), ", ".join(failed) or "none")
        return Group(table, Text(closing), Text(f"Table: {folder / FILE}"))


evaluation = Sensitivity()


def judged_designs(rows: Sequence[Row]) -> list[tuple[Row, dict[str, list[Criterion]]]]:
    """Return one row of each design, and the criteria of each figure for this design.

    A run that failed has no numbers. Then no criterion that needs them holds.
    """
    grouped: dict[int, dict[str, Row]] = {}
    for row in rows:
        grouped.setdefault(row["design"], {})[row["case"]] = row
    for name in criteria.RUNS:
        if any(name not in cases for cases in grouped.values()):
            raise ScenarioError(
                f"the statements need the cases {', '.join(criteria.RUNS)}; [cases.{name}] is missing"
            )
    found = []
    for cases in grouped.values():
        measures = {
            name: {
                column: math.nan if (value := cases[name][column]) is None else value
                for column in Sensitivity.columns
            }
            for name in criteria.RUNS
        }
        found.append((cases[criteria.RUNS[0]], criteria.by_figure(measures)))
    return found


def failing(judged: Mapping[str, Sequence[Criterion]]) -> list[str]:
    """Return the numbers of the figures whose statement does not hold."""
    return [
        figure.removeprefix("Fig. ")
        for figure, parts in judged.items()
        if not all(part.holds for part in parts)
    ]


def verdicts(
    designs: Sequence[tuple[Row, Mapping[str, Sequence[Criterion]]]], axes: Sequence[str]
) -> tuple[list[str], list[list[str]]]:
    """Return the header and the lines of the table of failing figures: one line for each axis."""
    factors = sorted({row[axis] for row, _ in designs for axis in axes if row[axis] is not None})
    lines = []
    for axis in axes:
        cells = {
            row[axis]: ", ".join(failing(judged)) or "-"
            for row, judged in designs
            if row[axis] is not None
        }
        lines.append([f"`{axis}`", *(cells.get(factor, "") for factor in factors)])
    return ["assumption", *(f"x {factor:g}" for factor in factors)], lines


def summary(
    designs: Sequence[tuple[Row, Mapping[str, Sequence[Criterion]]]], axes: Sequence[str]
) -> str:
    """Return a sentence on the designs near the assumptions, with the smallest margin."""
    near = [
        (row, judged)
        for row, judged in designs
        if all(row[axis] is None or row[axis] in NEAR for axis in axes)
        and any(row[axis] is not None for axis in axes)
    ]
    hold = sum(not failing(judged) for _, judged in near)
    margins = [
        (part.margin, figure, part, row)
        for row, judged in near
        for figure, parts in judged.items()
        for part in parts
        if part.margin is not None and not math.isnan(part.margin)
    ]
    if not margins:
        return f"{hold} of {len(near)} designs with one change of 5 or 10 % keep all statements."
    least, figure, part, row = min(margins, key=lambda item: item[0])
    changed = next(f"{axis} x {row[axis]:g}" for axis in axes if row[axis] is not None)
    return (
        f"{hold} of {len(near)} designs with one change of 5 or 10 % keep all statements. "
        f"The smallest margin of these designs is {least:.3g}: {figure}, {part.what}, with {changed}."
    )
