"""The energy audit as one figure: powers, balance, where energy enters and who takes it out, and what the observers believed."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from freeflyer.analysis.audit.ledger import Audit
from freeflyer.analysis.figure_style import STYLE
from freeflyer.fmi.component import Array

# Okabe and Ito's colours, each with a dash of its own, so that grey print tells them apart too.
B = {"color": "#D55E00", "ls": "-"}
M = {"color": "#0072B2", "ls": "--"}
KINETIC = {"color": "black", "ls": ":", "lw": 1.6}
RESIDUAL = {"color": "#CC79A7", "ls": "-", "lw": 0.8}
STALE = {"color": "#009E73", "ls": "-."}
TAKEN = {"color": "black", "ls": (0, (5, 1))}
DAMPED = {"color": "0.55", "ls": "-", "lw": 0.8}
TRUE = {"color": "0.35", "ls": ":", "lw": 1.8}
DECADES = 4
"""That a symmetric logarithmic axis shows of either sign."""


def draw(audit: Audit) -> Any:
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(4, 1, figsize=(7.6, 8.2), sharex=True)
        _powers(axes[0], audit)
        _balance(axes[1], audit)
        _sources(axes[2], audit)
        _beliefs(axes[3], audit)
        axes[-1].set_xlabel("time [s]")
        axes[-1].set_xlim(audit.time[0], audit.time[-1])
        for panel, letter in zip(axes, "abcd", strict=True):
            panel.set_title(f"({letter}) {panel.get_title(loc='left')}", loc="left", fontsize=8)
            # Beside the axes, so that it hides nothing.
            panel.legend(
                loc="upper left", bbox_to_anchor=(1.0, 1.03), handlelength=2.6, frameon=False
            )
        figure.align_ylabels(axes)
        return figure


def _powers(axes: Any, audit: Audit) -> None:
    axes.set_title("Power given to the robot", loc="left")
    axes.plot(audit.time, audit.base.power, label="port B, as it acts", **B)
    axes.plot(audit.time, audit.manipulator.power, label="port M", **M)
    axes.plot(audit.time, audit.tracking_power, label="port M, of the\ntracking error", **STALE)
    _scale(axes, "[W]", audit.base.power, audit.manipulator.power)


def _balance(axes: Any, audit: Audit) -> None:
    closes = (
        "True balance: work at the ports is the kinetic energy"
        if audit.balance
        else "Work at the ports (no balance to close)"
    )
    axes.set_title(closes, loc="left")
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
            axes.plot(audit.time, balance.others, label="work of others", **STALE)
    _scale(axes, "[J]", *lines)


def _sources(axes: Any, audit: Audit) -> None:
    axes.set_title("Where energy enters, and where it goes", loc="left")
    virtual_m, virtual_b = audit.manipulator.virtual, audit.base.virtual
    taken = audit.base.taken + audit.manipulator.taken
    damped = audit.base.dissipated + audit.manipulator.dissipated
    axes.plot(
        audit.time,
        audit.base.stale,
        label="in: multi-rate,\n$\\Sigma(F_B^{true} - F_B^{held})\\,\\Delta x_b$",
        **STALE,
    )
    axes.plot(audit.time, virtual_b, label="in: virtual, by the\nbase's held law", **B)
    axes.plot(audit.time, virtual_m, label="in: virtual, by the\nmanipulator's held law", **M)
    axes.plot(
        audit.time,
        damped,
        label="out: damping of both laws,\n$\\int \\dot{x}^T K_D \\dot{x}\\,dt$",
        **DAMPED,
    )
    axes.plot(audit.time, taken, label="out: taken by both\npassivity controllers", **TAKEN)
    _scale(axes, "[J]", audit.base.stale, virtual_b, virtual_m, damped, taken)


def _beliefs(axes: Any, audit: Audit) -> None:
    axes.set_title(
        f"What the observers ('{audit.loop.observer}') believed, and the truth: E(0) less the work at the port",
        loc="left",
    )
    lines = []
    for port, name, line in ((audit.base, "B", B), (audit.manipulator, "M", M)):
        believed, true = port.believed.sum(axis=1), port.absorbed.sum(axis=1)
        lines += [believed, true]
        axes.plot(audit.time, believed, label=f"observer of {name}, sum", **line)
        axes.plot(audit.time, true, label="their truths, sum" if name == "M" else None, **TRUE)
    for port, name, line in ((audit.base, "B", B), (audit.manipulator, "M", M)):
        least = port.believed.min(axis=1)
        lines.append(least)
        axes.plot(
            audit.time, least, label=f"observer of {name}, least DoF", **{**line, "alpha": 0.45}
        )
    axes.axhline(0.0, color="black", lw=0.5)
    _scale(axes, "[J]", *lines)


def _scale(axes: Any, unit: str, *lines: Array) -> None:
    """A symmetric logarithm where a line would else be flat beside another, or the run's first half beside its end."""
    axes.set_ylabel(unit)
    sizes = [float(np.abs(line).max()) for line in lines]
    early = max(float(np.abs(line[: max(1, line.size // 2)]).max()) for line in lines)
    largest = max(sizes)
    visible = [size for size in (*sizes, early) if size > largest * 10.0**-DECADES]
    if visible and largest > 30.0 * min(visible):
        threshold = 10.0 ** np.floor(np.log10(largest) - DECADES + 1)
        axes.set_yscale("symlog", linthresh=threshold, linscale=0.5)
        axes.autoscale(axis="y")  # margins anew, on this scale
