"""The command `freeflyer reproduce`."""

from __future__ import annotations

import argparse

from rich.console import Console

from freeflyer.foundation.extras import EXTRAS, require
from freeflyer.scenario.directory_option import add_directory
from freeflyer.scenario.run_directory import RunDirectory


class ReproduceCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        add_directory(
            parser, "freeflyer_out/reproduce-TIME-HASH; freeflyer_out/reproduce links to it"
        )
        parser.add_argument(
            "--fmi",
            type=int,
            choices=(2, 3),
            default=2,
            help="FMI version of the FMUs (default: 2)",
        )
        parser.add_argument(
            "--real-time",
            action="store_true",
            help="also run the facility experiment in real time over CAN and Zenoh (this takes 1 min more)",
        )

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        from freeflyer.paper import reproduce

        if arguments.real_time:
            require("freeflyer reproduce --real-time", EXTRAS["hil"])
        about = f"{arguments.fmi} {arguments.real_time}"
        claimed = (
            RunDirectory.unique("reproduce", about)
            if arguments.out is None
            else RunDirectory.claim(arguments.out, arguments.existing)
        )
        with claimed:
            return reproduce.reproduce(
                claimed, arguments.fmi, console, in_real_time=arguments.real_time
            )
