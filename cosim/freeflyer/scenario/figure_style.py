"""Common style of all figures, and their output formats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

from freeflyer.foundation.output_file import write_whole

matplotlib.use("Agg")
from matplotlib import pyplot as plt

STYLE: Any = {
    "font.size": 8,
    "axes.labelsize": 8,
    "legend.fontsize": 7,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "lines.linewidth": 1.0,
    "legend.framealpha": 0.8,
    "axes.formatter.limits": (-2, 3),
    "figure.constrained_layout.use": True,
}
# The line styles distinguish the lines in a grey print. Colour-blind readers can distinguish the
# colours.
LINES = (
    {"color": "#0072B2", "ls": "-"},
    {"color": "#D55E00", "ls": "--"},
    {"color": "#009E73", "ls": "-."},
)


def save(figure: Any, path: Path) -> None:
    """Write `path` as PNG and PDF, and close the figure. Raises OutputError."""
    write_whole(
        path.with_suffix(".png"), lambda partial: figure.savefig(partial, format="png", dpi=200)
    )
    write_whole(
        path.with_suffix(".pdf"),
        lambda partial: figure.savefig(partial, format="pdf", metadata={"CreationDate": None}),
    )
    plt.close(figure)
