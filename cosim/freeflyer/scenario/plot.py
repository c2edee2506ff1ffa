"""Figure of the errors of one or more runs over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from freeflyer.fmi.component import Array
from freeflyer.foundation.errors import CosimError
from freeflyer.scenario.figure_style import LINES, STYLE


def errors(runs: Sequence[tuple[Array, Mapping[str, Array]]], labels: Sequence[str]) -> Figure:
    """Draw every error of the runs: one panel for each error, one line for each run.

    A run is its times [s] and its errors by name (NAME_error_UNIT).
    Raises CosimError if the runs have no errors, or if a label is missing.
    """
    names = list(dict.fromkeys(name for _, values in runs for name in values))
    if not names:
        raise CosimError(
            "there is nothing to plot: the scenario has no table [errors]; plot signals of the record instead"
        )
    if len(labels) != len(runs):
        raise CosimError(f"{len(labels)} labels for {len(runs)} runs; one label each is expected")
    with plt.rc_context(STYLE):
        rows = (len(names) + 1) // 2
        figure, grid = plt.subplots(
            rows, min(2, len(names)), figsize=(7.0, 1.9 * rows), sharex=True, squeeze=False
        )
        for axes, name in zip(grid.flat, names, strict=False):
            what, _, unit = name.rpartition("_error_")
            for k, ((time, values), label) in enumerate(zip(runs, labels, strict=True)):
                if name in values:
                    axes.plot(time, values[name], label=label, **_line(k))
            axes.set_ylabel(f"{what.replace('_', ' ')}\nerror [{unit}]")
        for axes in grid.flat[len(names) :]:
            axes.remove()
        for axes in grid[-1]:
            axes.set_xlabel("time [s]")
        handles = {
            text: line
            for axes in grid.flat
            for line, text in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        figure.legend(handles.values(), handles, loc="outside upper center", ncols=2, frameon=False)
    plt.close(figure)  # remove the figure from pyplot; the caller still has it
    return figure


def _line(k: int) -> dict[str, str]:
    return LINES[k] if k < len(LINES) else {"color": f"C{k}", "ls": "-"}
