"""The command `freeflyer export`."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from freeflyer.cli.run import SCENARIO_HELP, add_overrides
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.exit_codes import DONE
from freeflyer.scenario import assemble, scenario
from freeflyer.ssp import write as ssp_write


class ExportCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("scenario", metavar="SCENARIO", help=SCENARIO_HELP)
        add_overrides(parser)
        parser.add_argument(
            "--fmi",
            type=int,
            choices=(2, 3),
            help="FMI version of the shipped FMUs: 2 for SSP 1.0, 3 for SSP 2.0 (default: the version in the scenario, otherwise 2)",
        )
        parser.add_argument("--out", type=Path, required=True, metavar="FILE.ssp")

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        if arguments.out.suffix != ".ssp":
            raise ScenarioError(f"--out {arguments.out}: a file name that ends in .ssp is expected")
        chosen = scenario.load(arguments.scenario, arguments.overrides)
        with assemble.loaded(chosen, arguments.fmi) as system:
            ssp_write.write(chosen, system, arguments.out)
        console.print(f"{arguments.out}: {len(system.components)} components", soft_wrap=True)
        return DONE
