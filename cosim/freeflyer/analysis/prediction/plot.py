"""Figure of a prediction: the growth rate as a function of the base period T_b.

The figure also shows the stable intervals and the largest stable period.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

from freeflyer.analysis.prediction.boundary import Scan
from freeflyer.analysis.prediction.trajectory import AlongTrajectory
from freeflyer.foundation.output_file import write_whole
from freeflyer.scenario.figure_style import LINES, STYLE

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure


def write(figure: Figure, path: Path) -> None:
    """Write the figure atomically as a PNG file. Raises OutputError."""
    write_whole(path, lambda partial: figure.savefig(partial, dpi=160, format="png"))


def scan(prediction: Scan, along: AlongTrajectory | None) -> Figure:
    """Draw the growth rate ln(radius) / T_b as a function of T_b.

    The radius is the spectral radius of the map over one base period. Stable periods have a
    negative growth rate. They are shaded. `along` is the result along the trajectory, if it was
    computed.
    """
    with plt.rc_context(STYLE):
        # Draw the growth rates of the scan. Extend the shading of each stable interval by half a
        # scan step on both sides.
        figure, axes = plt.subplots(figsize=(7.0, 2.8))
        rates = prediction.growth_rates
        axes.plot(prediction.periods, rates, label="at the set point", color=LINES[0]["color"])
        half = 0.5 * prediction.tick_s
        for first, last in prediction.stable_s:
            axes.axvspan(first - half, last + half, color="#009E73", alpha=0.12, lw=0)
        # Mark the upper end of the first stable interval.
        axes.axhline(0.0, color="black", lw=0.6)
        if prediction.boundary:
            axes.axvline(prediction.largest_stable_s, color="black", ls="--", lw=0.8)
            text = f"largest stable: {prediction.largest_stable_s:g} s"
            axes.annotate(
                text,
                (prediction.largest_stable_s, 0.97),
                xycoords=("data", "axes fraction"),
                xytext=(4, 0),
                textcoords="offset points",
                va="top",
            )
        # Mark the growth rates at the period of the scenario.
        axes.plot(
            prediction.period_s,
            prediction.own.growth_rate,
            "o",
            color=LINES[0]["color"],
            ms=4,
            label="period of the scenario",
        )
        if along:
            axes.plot(
                along.period_s,
                along.growth_rate,
                "s",
                color=LINES[1]["color"],
                ms=4,
                label="along the trajectory",
            )
        axes.set_xlabel("base period $T_b$ [s]")
        axes.set_ylabel("growth rate [1/s]")
        axes.set_xlim(0.0, prediction.longest_s)
        axes.legend(loc="lower right")
    plt.close(figure)  # remove the figure from pyplot; the caller still has it
    return figure
