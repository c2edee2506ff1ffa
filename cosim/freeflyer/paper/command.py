"""The command `freeflyer reproduce`."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from freeflyer.foundation.output_file import folder


class ReproduceCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--out", type=folder, default=Path("freeflyer_out") / "reproduce", metavar="DIR"
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

        return reproduce.reproduce(
            arguments.out, arguments.fmi, console, in_real_time=arguments.real_time
        )
