"""The command `freeflyer view`."""

from __future__ import annotations

import argparse
import webbrowser
from pathlib import Path

from rich.console import Console

from freeflyer.foundation.exit_codes import DONE
from freeflyer.viewer.view import view


class ViewCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "run",
            metavar="RUN",
            help="directory of a run, scenario, recording (.mcap), robot (.urdf) or FMU",
        )
        parser.add_argument("second", metavar="RUN", nargs="?", help="second run, to compare")
        parser.add_argument(
            "--out",
            type=Path,
            metavar="FILE.html",
            help="default: view.html in the directory of the run, or in the current folder",
        )
        parser.add_argument(
            "--signal",
            action="append",
            default=[],
            metavar="PATTERN",
            help="plot further recorded signals, for example 'free_flyer.joint_velocity'",
        )
        parser.add_argument(
            "--robot",
            type=Path,
            metavar="FILE",
            help="geometry (.urdf or .fmu) for a record without one",
        )
        parser.add_argument(
            "--open",
            action=argparse.BooleanOptionalAction,
            default=None,
            help="open the file in the browser (default: yes, if the output is a terminal)",
        )

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        sources = [arguments.run, *([arguments.second] if arguments.second else [])]
        shown = view(*sources, signals=arguments.signal, robot=arguments.robot)
        path = shown.write(arguments.out)
        for note in shown.notes:
            console.print(f"Note: {note}", soft_wrap=True)
        console.print(f"View of {shown.title}: {path}", soft_wrap=True)
        if console.is_terminal if arguments.open is None else arguments.open:
            try:
                opened = webbrowser.open(path.absolute().as_uri())
            except webbrowser.Error:
                opened = False
            if not opened:
                console.print("No browser was found; open the file in a browser", soft_wrap=True)
        return DONE
