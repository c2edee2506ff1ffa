"""Draw the stability map of a sweep over two parameters.

Each cell shows the result of a run: stable, growing errors, diverged (with the time), or failed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib import colors
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from freeflyer.fmi.component import Array
from freeflyer.scenario.figure_style import STYLE

STABLE, GROWING, FAILED = "#56B4E9", "#F0E442", "#999999"
"""Colours that are safe for colour-blind readers."""
DIVERGED = colors.LinearSegmentedColormap.from_list("divergence", ["#5B1A00", "#D55E00", "#F6C9AC"])
"""Colours of a diverged run. The colour depends on the time of divergence."""
Boundary = tuple[Array, Array]
"""Points (x, y) of a line, in the units of the axes."""


def draw(
    table: pa.Table,
    x: str,
    y: str,
    units: Mapping[str, str],
    boundary: Mapping[str, Boundary] | None = None,
) -> Figure:
    """Draw one panel per case, and return the figure.

    `table` has one row per run. A panel has one cell for each pair of values of the columns `x` and
    `y`. If the sweep has more than these two axes, several runs have the same cell, and the cell
    shows the worst run. `units` maps each column to its unit. `boundary` maps a case to a line that
    is drawn on top of the cells.
    """
    frame = table.to_pandas()
    cases = list(dict.fromkeys(frame["case"]))
    longest = float(np.nanmax(frame["simulated_s"])) if frame["simulated_s"].notna().any() else 1.0
    with plt.rc_context(STYLE | {"axes.grid": False}):
        # All panels have the same axes and the same colour scale for the times of divergence.
        figure, panels = plt.subplots(
            1,
            len(cases),
            figsize=(max(3.5, 3.2 * len(cases)) + 0.6, 3.3),
            sharex=True,
            sharey=True,
            squeeze=False,
        )
        shading = plt.cm.ScalarMappable(norm=colors.Normalize(0.0, longest), cmap=DIVERGED)
        for panel, case in zip(panels[0], cases, strict=True):
            # The cells define the limits of the axes. The boundary must not change these limits.
            rows = frame[frame["case"] == case]
            xs, ys = np.unique(rows[x]), np.unique(rows[y])
            panel.pcolormesh(
                edges(xs), edges(ys), cells(rows, x, y, xs, ys, shading), rasterized=True
            )
            if boundary is not None and case in boundary:
                panel.plot(*boundary[case], color="black", lw=1.5, label="predicted boundary")
                panel.set_xlim(edges(xs)[[0, -1]])
                panel.set_ylim(edges(ys)[[0, -1]])
            for values, scale in ((xs, panel.set_xscale), (ys, panel.set_yscale)):
                if is_logarithmic(values):
                    scale("log")
            panel.set_title(case.replace("_", " "), fontsize=8)
            panel.set_xlabel(label(x, units))
        # Add one colour bar and one legend for all panels.
        panels[0][0].set_ylabel(label(y, units))
        figure.colorbar(shading, ax=panels[0].tolist(), label="diverged at [s]")
        keys = [
            Patch(color=STABLE, label="stable"),
            Patch(color=GROWING, label="errors grow"),
            Patch(color=FAILED, label="failed, or too short"),
        ]
        handles = keys + panels[0][0].get_legend_handles_labels()[0]
        figure.legend(
            handles=handles,
            loc="outside upper center",
            ncols=len(handles) if len(cases) > 1 else 2,
            frameon=False,
        )
    return figure


def cells(rows: Any, x: str, y: str, xs: Array, ys: Array, shading: Any) -> Array:
    """Return the colours (len(ys), len(xs), 4) of the cells. A cell without a run is white.

    `rows` are the runs of one case. `xs` and `ys` are the ascending values of the columns `x` and
    `y`. `shading` is the colour scale for the times of divergence.
    """
    image = np.ones((ys.size, xs.size, 4))
    # The worst run of a cell is drawn last. The order from the best to the worst result is: stable,
    # growing errors, failed, late divergence, early divergence.
    rank = np.where(
        rows["diverged"].eq(True),
        4,
        np.where(rows["stable"].eq(True), 0, np.where(rows["stable"].eq(False), 1, 2)),
    )
    rank = np.where(rows["failed"].eq(True), 2, rank)
    order = np.lexsort((-rows["diverged_at_s"].fillna(0.0).to_numpy(), rank))
    places = (np.searchsorted(ys, rows[y]), np.searchsorted(xs, rows[x]))
    for number in order:
        if rank[number] == 4:
            colour = shading.to_rgba(rows["diverged_at_s"].iloc[number])
        else:
            colour = colors.to_rgba((STABLE, GROWING, FAILED)[rank[number]])
        image[places[0][number], places[1][number]] = colour
    return image


def is_logarithmic(values: Array) -> bool:
    """Return whether the ascending values fit a geometric grid better than a linear grid.

    A value that is not positive cannot be in a geometric grid.
    """
    if values.size < 3 or values[0] <= 0.0:
        return False
    return bool(
        np.ptp(np.diff(np.log(values))) / np.log(values[-1] / values[0])
        < np.ptp(np.diff(values)) / (values[-1] - values[0])
    )


def edges(values: Array) -> Array:
    """Return the n + 1 edges of the cells around n ascending values."""
    if values.size == 1:
        return np.array([0.9, 1.1]) * values[0] if values[0] else np.array([-0.5, 0.5])
    if is_logarithmic(values):
        borders = np.exp(edges_between(np.log(values)))
    else:
        borders = edges_between(values)
        borders = (
            np.maximum(borders, 0.0) if values[0] > 0.0 else borders
        )  # a period is not negative
    # The logarithm has a rounding error. If two neighbouring values are almost equal, this error
    # can be larger than their distance. Then the edge would not lie between the values.
    borders[1:-1] = np.clip(borders[1:-1], values[:-1], values[1:])
    borders[[0, -1]] = min(borders[0], values[0]), max(borders[-1], values[-1])
    return borders


def edges_between(values: Array) -> Array:
    """Return the n + 1 edges of the cells around n values.

    The inner edges are at the midpoints. The outer edges are half a cell beyond the end values.
    """
    middles = 0.5 * (values[1:] + values[:-1])
    return np.concatenate(
        [[1.5 * values[0] - 0.5 * values[1]], middles, [1.5 * values[-1] - 0.5 * values[-2]]]
    )


def label(column: str, units: Mapping[str, str]) -> str:
    """Return the axis label of a column. The unit "1" marks a factor of the scenario's value."""
    unit = units.get(column, "")
    return (
        f"{column} [{unit}]"
        if unit not in ("", "1")
        else f"{column} / value in the scenario"
        if unit == "1"
        else column
    )
