"""Predict the largest stable base period of a scenario from its linearised loop."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from freeflyer.analysis.prediction import sentences, trajectory
from freeflyer.analysis.prediction.boundary import Scan, scan
from freeflyer.analysis.prediction.set_point import at_set_point
from freeflyer.analysis.prediction.trajectory import AlongTrajectory, Progress
from freeflyer.foundation.interrupts import interrupts
from freeflyer.foundation.output_file import write_text
from freeflyer.scenario.overrides import Changes
from freeflyer.scenario.scenario import Scenario, loaded

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True, repr=False)
class Prediction(Scan):
    """Result of `predict`: the members of `Scan`, and the result along the trajectory.

    Times are in s. `largest_stable_s` is the end of the first stable interval, `stable_s` contains
    all stable intervals. `boundary` is the least stable mode at the first unstable period, and
    `limit` its cause; both are None if all periods are stable. `own` is the least stable mode at
    the period of the scenario. `along` is None unless it was requested.
    """

    along: AlongTrajectory | None = None

    def __repr__(self) -> str:
        lines = sentences.of_set_point(self)
        return "\n".join(lines + (sentences.of_trajectory(self.along) if self.along else []))

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>"

    def plot(self) -> Figure:
        """Return the figure of prediction.png: growth rate [1/s] over the base period [s]."""
        from freeflyer.analysis.prediction import plot

        return plot.scan(self, self.along)

    def write(self, directory: str | os.PathLike[str]) -> None:
        """Write prediction.json and prediction.png. Raises OutputError."""
        from freeflyer.analysis.prediction import plot

        folder = Path(directory)
        with interrupts():  # Ctrl-C takes effect after both files are complete
            write_text(folder / "prediction.json", json.dumps(self.summary(), indent=2) + "\n")
            plot.write(self.plot(), folder / "prediction.png")

    def summary(self) -> dict[str, Any]:
        """Return the content of prediction.json."""
        return {**super().summary(), "along_trajectory": self.along and self.along.summary()}


def predict(
    scenario: Scenario | str | os.PathLike[str],
    changes: Changes = (),
    *,
    longest: float | None = None,
    component: str | None = None,
    beyond: bool = True,
    along_trajectory: bool = False,
    progress: Progress | None = None,
) -> Prediction:
    """Predict the largest stable period of `component` (default: the slowest controller).

    `scenario` and `changes` are those of `freeflyer.run`. The period is scanned up to `longest` [s]
    in steps of T_m. If `beyond` is false, the scan stops soon after the first unstable period. It
    then does not find stable intervals above this period. Sweeps pass `beyond=False`. With
    `along_trajectory`, the loop is also analysed along the motion of the scenario, and `progress`
    is called with the completed fraction. The passivity controllers are off. The start of the
    scenario must be a set point (docs/prediction.md). Raises CosimError.
    """
    with at_set_point(loaded(scenario, changes), component) as here:
        if along_trajectory:
            trajectory.check_length(here.model)
        found, along = scan(here, longest, beyond=beyond), None
        if along_trajectory:
            along = trajectory.along_trajectory(
                here.model, found.coordinates, found.largest_stable_s, found.longest_s, progress
            )
    return Prediction(**vars(found), along=along)
