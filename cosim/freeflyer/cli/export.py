"""The command `freeflyer export`."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from freeflyer.cli.run import SCENARIO_HELP, add_overrides
from freeflyer.foundation.exit_codes import DONE
from freeflyer.scenario import scenario
from freeflyer.ssp.write import write_ssp


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
        chosen = scenario.load(arguments.scenario, arguments.overrides)
        system = write_ssp(chosen, arguments.out, fmi=arguments.fmi)
        console.print(f"{arguments.out}: {len(system.components)} components", soft_wrap=True)
        return DONE
