"""Figure of the energy audit: powers, balance, sources and sinks, observed and true energy."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from freeflyer.analysis.audit.ledger import Audit
from freeflyer.analysis.figure_style import STYLE
from freeflyer.fmi.component import Array

# Colours of Okabe and Ito. Each has its own dash, so that the lines differ in grey print.
B = {"color": "#D55E00", "ls": "-"}
M = {"color": "#0072B2", "ls": "--"}
KINETIC = {"color": "black", "ls": ":", "lw": 1.6}
RESIDUAL = {"color": "#CC79A7", "ls": "-", "lw": 0.8}
STALE = {"color": "#009E73", "ls": "-."}
TAKEN = {"color": "black", "ls": (0, (5, 1))}
DAMPED = {"color": "0.55", "ls": "-", "lw": 0.8}
TRUE = {"color": "0.35", "ls": ":", "lw": 1.8}
DECADES = 4
"""Decades that a symmetric logarithmic axis shows for each sign."""


def draw(audit: Audit) -> Any:
    """Return the figure, with four panels over time."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(4, 1, figsize=(7.6, 8.2), sharex=True)
        _powers(axes[0], audit)
        _balance(axes[1], audit)
        _sources(axes[2], audit)
        _observed(axes[3], audit)
        axes[-1].set_xlabel("time [s]")
        axes[-1].set_xlim(audit.time[0], audit.time[-1])
        for panel, letter in zip(axes, "abcd", strict=True):
            panel.set_title(f"({letter}) {panel.get_title(loc='left')}", loc="left", fontsize=8)
            # Beside the axes, where the legend hides no line.
            panel.legend(
                loc="upper left", bbox_to_anchor=(1.0, 1.03), handlelength=2.6, frameon=False
            )
        figure.align_ylabels(axes)
        return figure


def _powers(axes: Any, audit: Audit) -> None:
    axes.set_title("Power given to the robot", loc="left")
    axes.plot(audit.time, audit.base.power, label="port B, true wrench", **B)
    axes.plot(audit.time, audit.manipulator.power, label="port M", **M)
    axes.plot(audit.time, audit.tracking_power, label="port M,\ntracking error", **STALE)
    _scale(axes, "[W]", audit.base.power, audit.manipulator.power)


def _balance(axes: Any, audit: Audit) -> None:
    title = (
        "Balance: work at the ports and kinetic energy"
        if audit.balance
        else "Work at the ports (no kinetic energy recorded)"
    )
    axes.set_title(title, loc="left")
    lines = [audit.base.work, audit.manipulator.work]
    axes.plot(audit.time, audit.base.work, label="work at port B", **B)
    axes.plot(audit.time, audit.manipulator.work, label="work at port M", **M)
    if audit.balance is not None:
        balance = audit.balance
        lines += [balance.kinetic]
        worst = np.abs(balance.residual_of_ports).max()
        axes.plot(audit.time, balance.kinetic, label="kinetic energy, change", **KINETIC)
        axes.plot(
            audit.time,
            balance.residual_of_ports,
            label=f"residual,\nat most {worst:.1e} J",
            **RESIDUAL,
        )
        if np.any(balance.others):
            axes.plot(audit.time, balance.others, label="work of other\ncomponents", **STALE)
    _scale(axes, "[J]", *lines)


def _sources(axes: Any, audit: Audit) -> None:
    axes.set_title("Energy sources and sinks", loc="left")
    virtual_m, virtual_b = audit.manipulator.virtual, audit.base.virtual
    taken = audit.base.taken + audit.manipulator.taken
    damped = audit.base.dissipated + audit.manipulator.dissipated
    axes.plot(
        audit.time,
        audit.base.stale,
        label="in: multi-rate,\n$\\Sigma(F_B^{true} - F_B^{held})\\,\\Delta x_b$",
        **STALE,
    )
    axes.plot(audit.time, virtual_b, label="in: virtual,\nheld law of the base", **B)
    axes.plot(audit.time, virtual_m, label="in: virtual, held law\nof the manipulator", **M)
    axes.plot(
        audit.time,
        damped,
        label="out: damping of both laws,\n$\\int \\dot{x}^T K_D \\dot{x}\\,dt$",
        **DAMPED,
    )
    axes.plot(audit.time, taken, label="out: both passivity\ncontrollers", **TAKEN)
    _scale(axes, "[J]", audit.base.stale, virtual_b, virtual_m, damped, taken)


def _observed(axes: Any, audit: Audit) -> None:
    axes.set_title(
        f"Observed energy ('{audit.loop.observer}' observer) and true energy: E(0) less the work at the port",
        loc="left",
    )
    lines = []
    for port, name, line in ((audit.base, "B", B), (audit.manipulator, "M", M)):
        observed, true = port.observed.sum(axis=1), port.absorbed.sum(axis=1)
        lines += [observed, true]
        axes.plot(audit.time, observed, label=f"observer of {name}, sum", **line)
        axes.plot(audit.time, true, label="true energy, sum" if name == "M" else None, **TRUE)
    for port, name, line in ((audit.base, "B", B), (audit.manipulator, "M", M)):
        least = port.observed.min(axis=1)
        lines.append(least)
        axes.plot(
            audit.time, least, label=f"observer of {name}, least DoF", **{**line, "alpha": 0.45}
        )
    axes.axhline(0.0, color="black", lw=0.5)
    _scale(axes, "[J]", *lines)


def _scale(axes: Any, unit: str, *lines: Array) -> None:
    """Label the axis; make it symmetric logarithmic if a line would otherwise look flat.

    The first half of the run counts as one more line.
    """
    axes.set_ylabel(unit)
    sizes = [float(np.abs(line).max()) for line in lines]
    early = max(float(np.abs(line[: max(1, line.size // 2)]).max()) for line in lines)
    largest = max(sizes)
    visible = [size for size in (*sizes, early) if size > largest * 10.0**-DECADES]
    if visible and largest > 30.0 * min(visible):
        threshold = 10.0 ** np.floor(np.log10(largest) - DECADES + 1)
        axes.set_yscale("symlog", linthresh=threshold, linscale=0.5)
        axes.autoscale(axis="y")  # recompute the margins for this scale
