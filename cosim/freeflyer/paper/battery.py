"""Evaluation of the sweep `battery`: which strategies recover from which disturbances.

A run is stable by the criterion of every sweep (docs/sweeps.md). It is convergent if it is stable
and its errors stay within LIMITS in the last two windows of 10 s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from freeflyer.foundation.output_file import write_text
from freeflyer.scenario.experiment import Result
from freeflyer.scenario.metrics import LAST

LIMITS = {
    "end_effector_position_error_m": 2e-3,
    "end_effector_orientation_error_deg": 0.2,
    "base_position_error_m": 5e-3,
    "base_orientation_error_deg": 0.5,
}
CEILING = "ceiling"
"""The case in which both controllers have the period of the manipulator controller."""
FILE, FIGURE = "battery.md", "battery.png"
Row = Mapping[str, Any]


class Battery:
    """See `freeflyer.analysis.sweep.evaluation.Evaluation`."""

    signals = ()
    columns: Mapping[str, str] = {"within_limits": "1"}

    def measure(self, result: Result) -> Mapping[str, float]:
        end = result.outcome.simulated
        late = result.outcome.record.time >= end - 2.0 * LAST
        within = all(result.errors[name][late].max() <= limit for name, limit in LIMITS.items())
        return {"within_limits": float(within)}

    def report(self, rows: Sequence[Row], axes: Sequence[str], folder: Path) -> RenderableType:
        from freeflyer.paper import battery_figure
        from freeflyer.scenario.figure_style import save

        del axes
        header = (
            "strategy",
            "named: stable",
            "named: convergent",
            "drawn: stable",
            "drawn: convergent",
            "drawn: of those convergent with the ceiling",
        )
        table = Table(*header)
        lines = [header, ["---"] * len(header)]
        for case in dict.fromkeys(row["case"] for row in rows):
            line = [case, *counted(rows, case)]
            table.add_row(*line)
            lines.append(line)
        lost = "\n".join(f"- {text}" for text in not_convergent(rows))
        text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        write_text(folder / FILE, f"{text}\n\n{lost}\n")
        figure = battery_figure.draw(verdicts(rows, drawn=False), verdicts(rows, drawn=True))
        save(figure, folder / FIGURE)
        return Group(table, Text(f"Table: {folder / FILE}, figure: {folder / FIGURE}"))


evaluation = Battery()


def is_drawn(row: Row) -> bool:
    return str(row["design_name"]).startswith("drawn ")


def convergent(row: Row) -> bool:
    return bool(row["stable"]) and row["within_limits"] == 1.0


def verdict(row: Row) -> str:
    """Return the verdict on a run: a key of `battery_figure.COLOURS`."""
    return "convergent" if convergent(row) else "stable only" if row["stable"] else "not stable"


def verdicts(rows: Sequence[Row], drawn: bool) -> dict[tuple[str, str], str]:
    """Return the verdict on each strategy and disturbance, of the drawn or of the named cases."""
    return {
        (row["case"], row["design_name"]): verdict(row) for row in rows if is_drawn(row) is drawn
    }


def counted(rows: Sequence[Row], case: str) -> list[str]:
    """Return the numbers of a strategy for the table."""
    own = [row for row in rows if row["case"] == case]
    won = {row["design_name"] for row in rows if row["case"] == CEILING and convergent(row)}
    numbers = []
    for group in ([r for r in own if not is_drawn(r)], [r for r in own if is_drawn(r)]):
        numbers.append(f"{sum(row['stable'] is True for row in group)} of {len(group)}")
        numbers.append(f"{sum(map(convergent, group))} of {len(group)}")
    both = [row for row in own if is_drawn(row) and row["design_name"] in won]
    share = f"{sum(map(convergent, both))} of {len(both)}"
    return [*numbers, share]


def not_convergent(rows: Sequence[Row]) -> list[str]:
    """Return a line for each strategy, with the designs that are not convergent."""
    found = []
    for case in dict.fromkeys(row["case"] for row in rows):
        names = [
            f"{row['design_name']} ({'stable' if row['stable'] else 'not stable'})"
            for row in rows
            if row["case"] == case and not convergent(row)
        ]
        found.append(f"`{case}`: {'; '.join(names) or 'none'}")
    return found
