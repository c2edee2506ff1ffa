"""The command `freeflyer run`, and functions that other commands share."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import get_args

from rich.console import Console

from freeflyer.analysis import observer_notes
from freeflyer.cli.console import as_rich
from freeflyer.foundation.errors import ScenarioError
from freeflyer.scenario import experiment, scenario
from freeflyer.scenario.directory_option import add_directory
from freeflyer.scenario.experiment import Result
from freeflyer.scenario.saved_run import open_run
from freeflyer.scenario.scenario import Scenario, of_run
from freeflyer.scenario.verdict import verdict

# Each subcommand imports only the modules that it needs. Therefore a run of a scenario imports
# neither the code for SSP files nor the code for figures.

SCENARIO_HELP = f"{', '.join(scenario.shipped())}, or a .toml file"


def loaded(name: str, overrides: Sequence[str], step: float | None) -> Scenario:
    """Load a scenario by name, or from a TOML or SSP file. Raises CosimError.

    `step` [s] is the communication step of the components that have no step in the SSP file.
    """
    run = of_run(name)
    if run is not None and run.get("ssp") is not None and step is None:
        from freeflyer.ssp.read import load_ssp

        again = [*run["changes"], *overrides]
        return load_ssp(run["ssp"]["path"], again, step=run["ssp"]["step"])
    if not name.lower().endswith(".ssp"):
        if step is not None:
            raise ScenarioError(
                "--step belongs to an .ssp file; in a scenario every component has its step_s"
            )
        return scenario.load(name, overrides)
    from freeflyer.ssp.read import load_ssp

    return load_ssp(name, overrides, step=step)


def add_overrides(parser: argparse.ArgumentParser, text: str | None = None) -> None:
    """Add the option `--set`. `text` is the help text."""
    form = "COMPONENT.PARAMETER=VALUE"
    parser.add_argument(
        "--set", action="append", default=[], metavar=form, dest="overrides", help=text
    )


def add_fmi(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--fmi",
        type=int,
        choices=(2, 3),
        help="FMI version of the shipped FMUs (default: the version in the scenario, otherwise 2)",
    )


class RunCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "scenario",
            metavar="SCENARIO",
            help=f"{SCENARIO_HELP}, an .ssp file, or the directory of a run, to repeat it",
        )
        parser.add_argument(
            "--step",
            type=float,
            metavar="SECONDS",
            help="communication step of the components that have no step in the .ssp file",
        )
        add_overrides(parser)
        add_fmi(parser)
        parser.add_argument(
            "--master",
            choices=get_args(experiment.Engine),
            default="core",
            help="master that steps the FMUs: native code (default) or Python with FMPy; the results are equal",
        )
        parser.add_argument(
            "--case",
            type=int,
            metavar="N",
            help="SCENARIO is the directory of a sweep: repeat its run N, with a complete record",
        )
        add_directory(
            parser, "freeflyer_out/SCENARIO-TIME-HASH; freeflyer_out/SCENARIO links to it"
        )

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        if arguments.fmi is not None and arguments.scenario.lower().endswith(".ssp"):
            raise ScenarioError("--fmi belongs to scenarios; an .ssp file contains its own FMUs")
        # Find what is repeated, if anything. A directory may be a link that leads to the new run
        # afterwards.
        fmi, name = arguments.fmi, arguments.scenario
        source = Path(os.path.realpath(name)) if os.path.isdir(name) else Path(name)
        compare: Callable[[Result], Sequence[str]] | None = None
        if arguments.case is not None:
            from freeflyer.analysis.sweep.repeat import run_of

            repeated = run_of(source, arguments.case)
            chosen = repeated.scenario.changed(arguments.overrides)
            fmi, compare = fmi or repeated.fmi, repeated.differences
        else:
            chosen = loaded(name, arguments.overrides, arguments.step)
            about = of_run(name)
            compare = open_run(source).differences if about else None
            if about is not None and about["engine"] == "devices":
                compare = None
                console.print(f"Note: {name} is a run with devices; their models are simulated here (`freeflyer hil {name}` uses the devices)", soft_wrap=True)  # fmt: skip
        directory = experiment.claim(chosen, arguments.out, arguments.existing)
        with experiment.progress_bar(console, [chosen]) as reports:
            result = experiment.run(
                chosen,
                fmi=fmi,
                progress=reports[chosen.name],
                engine=arguments.master,
                directory=directory,
            )
        console.print(as_rich(result.table))
        for note in observer_notes.notes(result.outcome.record.provenance):
            console.print(f"Note: {note}", soft_wrap=True)
        if result.verdict == "diverged":
            from freeflyer.analysis import divergence_notes

            for note in divergence_notes.notes(chosen, result.record, fmi):
                console.print(f"Note: {note}", soft_wrap=True)
        for line in directory.lines:
            console.print(line, soft_wrap=True)
        if compare is not None:
            what = f"{source}" if arguments.case is None else f"run {arguments.case} of {source}"
            found = compare(result)
            for line in [f"Different from {what}:", *found] if found else [f"Same bits as {what}."]:
                console.print(line, soft_wrap=True)
        return verdict(result.scenario, result.outcome)
