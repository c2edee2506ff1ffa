"""Figure of the battery: one row of cells per strategy, one cell per disturbance."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib import pyplot as plt
from matplotlib.patches import Patch

from freeflyer.scenario.figure_style import STYLE

COLOURS = {"convergent": "#A6D8F5", "stable only": "#E69F00", "not stable": "#6B1F00"}
"""A worse verdict has a darker colour. Colour-blind readers and a grey print show the order."""
KINDS = {
    "none": "nominal",
    "repeated push": "joint .* every |base .* every ",
    "push on a joint": "joint ",
    "push on the base": "base ",
    "noise": "noise ",
    "wrong masses": "model |true tool ",
    "trajectory": "traj ",
    "posture": "posture ",
    "base period": "T_b ",
    "late command": "delay ",
    "weak or on-off actuators": "sat |thrusters ",
    "start error": "start ",
    "combination": "combo ",
}
"""Kinds of disturbances, with the start of the names of their cases (a regular expression)."""
OTHER = "other"
GAP = 1.0
"""Space between two groups of cells; a cell and its space have the width 1."""
FILLED = 0.88
Verdicts = Mapping[tuple[str, str], str]
"""The verdict (a key of COLOURS) of each strategy and disturbance."""


def draw(named: Verdicts, drawn: Verdicts) -> Any:
    """Return the figure. It has one panel for named cases and one for drawn cases.

    The named cases are grouped by the kind of the disturbance. The drawn cases are sorted by the
    number of strategies that are convergent. A panel without cases is left out.
    """
    panels = [
        (verdicts, groups, title)
        for verdicts, groups, title in (
            (named, grouped(named), "named cases"),
            (drawn, [("", sorted_by_ease(drawn))], "drawn cases, the easiest first"),
        )
        if verdicts
    ]
    with plt.rc_context(STYLE | {"axes.grid": False, "legend.fontsize": 8}):
        figure, axes = plt.subplots(
            len(panels),
            1,
            figsize=(10.0, 0.2 + 2.7 * len(panels)),
            squeeze=False,
        )
        for panel, (verdicts, groups, title) in zip(axes[:, 0], panels, strict=True):
            count = sum(len(names) for _, names in groups)
            # The names of the groups are between the title and the cells.
            space = 48 if groups[0][0] else 10
            panel.set_title(
                f"{count} {title}", loc="left", pad=space, fontsize=9, fontweight="bold"
            )
            fill(panel, verdicts, groups)
        keys = [Patch(color=colour, label=verdict) for verdict, colour in COLOURS.items()]
        figure.legend(handles=keys, loc="outside upper right", ncols=len(keys), frameon=False)
    return figure


def fill(panel: Any, verdicts: Verdicts, groups: Sequence[tuple[str, Sequence[str]]]) -> None:
    """Draw the cells of one panel, the names of rows and columns, and the convergent shares."""
    strategies = strategies_of(verdicts)
    # The groups stand side by side, with a gap between two of them.
    places: dict[str, float] = {}
    start = 0.0
    for kind, names in groups:
        places |= {name: start + number for number, name in enumerate(names)}
        end = start + len(names) - (1.0 - FILLED)
        if kind:
            panel.plot([start, end], [-0.25, -0.25], color="0.4", lw=0.8, solid_capstyle="butt")
            panel.text(
                start, -0.45, kind, rotation=30, rotation_mode="anchor", ha="left", va="bottom"
            )
        start += len(names) + GAP
    width = start - GAP
    # The rows stand one below the other: the y axis points down.
    for row, strategy in enumerate(strategies):
        cells = {name: verdicts[strategy, name] for name in places if (strategy, name) in verdicts}
        panel.broken_barh(
            [(places[name], FILLED) for name in cells],
            (row, FILLED),
            facecolors=[COLOURS[verdict] for verdict in cells.values()],
        )
        convergent = sum(verdict == "convergent" for verdict in cells.values())
        panel.text(width + 0.8, row + 0.5 * FILLED, f"{convergent} of {len(cells)}", va="center")
    panel.text(width + 0.8, -0.15, "convergent", va="bottom")
    panel.set_xlim(-0.3, width + 0.3)
    panel.set_ylim(len(strategies), -0.4)
    panel.set_yticks(
        [row + 0.5 * FILLED for row in range(len(strategies))],
        [strategy.replace("_", " ").replace(" pc", " PC") for strategy in strategies],
    )
    panel.set_xticks(
        [place + 0.5 * FILLED for place in places.values()],
        [name.removeprefix("drawn ") for name in places],
        rotation=90,
        fontsize=6.5,
    )
    panel.tick_params(length=0, pad=3)
    panel.spines[:].set_visible(False)


def strategies_of(verdicts: Verdicts) -> list[str]:
    return list(dict.fromkeys(strategy for strategy, _ in verdicts))


def grouped(verdicts: Verdicts) -> list[tuple[str, list[str]]]:
    """Return the kinds of disturbances in the order of their first case, with their cases."""
    groups: dict[str, list[str]] = {}
    for name in dict.fromkeys(name for _, name in verdicts):
        groups.setdefault(kind(name), []).append(name)
    return list(groups.items())


def kind(name: str) -> str:
    """Return the kind of the disturbance of a named case."""
    return next((found for found, pattern in KINDS.items() if re.match(pattern, name)), OTHER)


def sorted_by_ease(verdicts: Verdicts) -> list[str]:
    """Return the cases, sorted by the number of strategies that are convergent, then stable."""
    names = dict.fromkeys(name for _, name in verdicts)
    found = {
        name: [verdict for (_, case), verdict in verdicts.items() if case == name] for name in names
    }
    return sorted(
        names, key=lambda name: (-found[name].count("convergent"), found[name].count("not stable"))
    )
