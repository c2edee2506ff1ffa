"""The command `freeflyer predict`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from freeflyer.analysis.prediction import plot as prediction_plot
from freeflyer.analysis.prediction.boundary import LONGEST, Prediction, scan
from freeflyer.analysis.prediction.modes import Mode
from freeflyer.analysis.prediction.set_point import SetPoint, at_set_point
from freeflyer.analysis.prediction.trajectory import AlongTrajectory, along_trajectory, check_length
from freeflyer.cli.run import SCENARIO_HELP, add_overrides
from freeflyer.foundation.exit_codes import DONE
from freeflyer.foundation.interrupts import interrupts
from freeflyer.foundation.output_file import check_writable, folder, write_text
from freeflyer.scenario import scenario


class PredictCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("scenario", metavar="SCENARIO", help=SCENARIO_HELP)
        add_overrides(parser)
        parser.add_argument(
            "--longest",
            type=float,
            metavar="SECONDS",
            help=f"longest period that is scanned (default: {LONGEST:g}, or the period in the scenario if this period is longer)",
        )
        parser.add_argument(
            "--period",
            metavar="COMPONENT",
            help="controller whose period is scanned (default: the controller with the longest period)",
        )
        parser.add_argument(
            "--along-trajectory",
            action="store_true",
            help="also predict the stability along the motion of the scenario, not only at its start",
        )
        parser.add_argument(
            "--out",
            type=folder,
            metavar="DIR",
            help="also write prediction.json and prediction.png to this directory",
        )

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        chosen = scenario.load(arguments.scenario, arguments.overrides)
        if arguments.out:
            check_writable(arguments.out)
        along = None
        with at_set_point(chosen, arguments.period) as here:
            if arguments.along_trajectory:
                check_length(here.model)
            prediction = scan(here, arguments.longest)
            _print_set_point(prediction, console)
            if arguments.along_trajectory:
                along = _along(here, prediction, console)
                _print_along(along, console)
        if arguments.out:
            _write(prediction, along, arguments.out)
            console.print(
                f"Results in {arguments.out}: prediction.json, prediction.png", soft_wrap=True
            )
        return DONE


def milliseconds(time: float) -> str:
    return f"{1e3 * time:.6g} ms"


def _print_set_point(prediction: Prediction, console: Console) -> None:
    def print_line(text: str) -> None:
        console.print(text, soft_wrap=True)

    print_line(
        f"{prediction.scenario}: period T_b of {prediction.component}, from {milliseconds(prediction.shortest_s)} to "
        f"{milliseconds(prediction.longest_s)}; at the set point, with passivity controllers off"
    )
    if prediction.shortest_s > prediction.tick_s:
        print_line(f"The controllers accept no period below {milliseconds(prediction.shortest_s)}.")
    if prediction.boundary is None:
        print_line(
            f"Largest stable T_b: {milliseconds(prediction.largest_stable_s)} or more (all scanned periods are stable)"
        )
    elif prediction.largest_stable_s == 0.0:
        print_line(
            f"Largest stable T_b: none (the loop is unstable even at {milliseconds(prediction.shortest_s)})"
        )
    else:
        print_line(f"Largest stable T_b: {milliseconds(prediction.largest_stable_s)}")
    beyond = [
        interval for interval in prediction.stable_s if interval[0] > prediction.largest_stable_s
    ]
    for first, last in beyond:
        print_line(f"Stable again: {milliseconds(first)} to {milliseconds(last)}")
    if prediction.boundary and prediction.limit:
        print_line(f"Unstable mode: {prediction.boundary.description()}")
        print_line(f"  at {_grows(prediction.boundary)}")
        print_line(f"Limited by {prediction.limit.description()}")
    print_line(f"With T_b of the scenario: at {_grows(prediction.own)}")
    if prediction.neutral:
        print_line(
            f"{prediction.neutral} neutral modes are left out. A neutral mode neither grows nor decays, because it has no "
            f"restoring force (null space, or no stiffness)."
        )


def _grows(mode: Mode) -> str:
    z = mode.multiplier
    value = f"{z.real:.4f}" if z.imag == 0.0 else f"{z.real:.4f} +- {abs(z.imag):.4f} i"
    rate = mode.growth_rate
    pace = (
        f"doubles every {0.693147 / rate:.3g} s"
        if rate > 0.0
        else f"halves every {-0.693147 / rate:.3g} s"
        if rate < 0.0
        else "constant"
    )
    return f"{milliseconds(mode.period)} {'unstable' if abs(z) >= 1.0 else 'stable'}: multiplier {value}, {rate:+.3g} 1/s ({pace})"


def _along(here: SetPoint, prediction: Prediction, console: Console) -> AlongTrajectory:
    columns = (TextColumn("{task.description}", markup=False), BarColumn())
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task("along the trajectory", total=1.0)
        return along_trajectory(
            here.model,
            prediction.coordinates,
            prediction.largest_stable_s,
            prediction.longest_s,
            lambda share: bar.update(task, completed=share),
        )


def _print_along(along: AlongTrajectory, console: Console) -> None:
    def print_line(text: str) -> None:
        console.print(text, soft_wrap=True)

    print_line(
        f"Along the trajectory, from Floquet multipliers (the motion from {along.from_s:g} to {along.to_s:g} s is assumed to be "
        f"periodic):"
    )
    print_line(f"  largest stable T_b: {milliseconds(along.largest_stable_s)} (by bisection)")
    print_line(
        f"  at {milliseconds(along.period_s)}: {along.growth_rate:+.3g} 1/s, {'unstable' if along.growth_rate >= 0.0 else 'stable'}"
    )
    print_line(
        f"  frozen-time loop (not a criterion of stability): unstable {100 * along.frozen_unstable:.0f} % of the time; "
        f"its largest growth rate is {along.frozen_growth_rate:+.3g} 1/s (at {along.frozen_at_s:g} s)"
    )


def _write(prediction: Prediction, along: AlongTrajectory | None, directory: Path) -> None:
    """Write prediction.json and prediction.png. Raises OutputError."""
    summary = {**prediction.summary(), "along_trajectory": along and along.summary()}
    with interrupts():  # Ctrl-C takes effect after both files are complete
        write_text(directory / "prediction.json", json.dumps(summary, indent=2) + "\n")
        prediction_plot.write(prediction, along, directory / "prediction.png")
