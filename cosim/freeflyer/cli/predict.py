"""The command `freeflyer predict`."""

from __future__ import annotations

import argparse

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from freeflyer.analysis.prediction.boundary import LONGEST
from freeflyer.analysis.prediction.predict import predict
from freeflyer.cli.run import SCENARIO_HELP, add_overrides
from freeflyer.foundation.exit_codes import DONE
from freeflyer.foundation.output_file import check_writable, folder
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
        columns = (TextColumn("{task.description}", markup=False), BarColumn())
        with Progress(
            *columns, console=console, transient=True, disable=not console.is_terminal
        ) as bar:
            task = bar.add_task("along the trajectory", total=1.0, visible=False)
            prediction = predict(
                chosen,
                longest=arguments.longest,
                component=arguments.period,
                along_trajectory=arguments.along_trajectory,
                progress=lambda share: bar.update(task, completed=share, visible=True),
            )
        console.print(repr(prediction), soft_wrap=True)
        if arguments.out:
            prediction.write(arguments.out)
            console.print(
                f"Results in {arguments.out}: prediction.json, prediction.png", soft_wrap=True
            )
        return DONE
