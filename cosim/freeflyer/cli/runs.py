"""The command `freeflyer runs`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import get_args

from rich.console import Console

from freeflyer.analysis.runs import RunState, runs
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.exit_codes import DONE
from freeflyer.foundation.output_file import folder
from freeflyer.scenario.description import changed
from freeflyer.scenario.run_state import OUT


class RunsCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "folder",
            type=folder,
            nargs="*",
            metavar="DIR",
            help=f"folder with runs, or directory of one run (default: {OUT})",
        )
        parser.add_argument("--scenario", metavar="NAME", help="only runs of this scenario")
        parser.add_argument(
            "--end", choices=get_args(RunState), help="only runs that have ended in this way"
        )
        parser.add_argument(
            "--where",
            action="append",
            default=[],
            metavar="COMPONENT.PARAMETER=VALUE",
            help="only runs with this value of a parameter",
        )
        parser.add_argument(
            "--compare",
            action="store_true",
            help="show the runs side by side: parameters that differ, errors, ends",
        )
        parser.add_argument("--json", action="store_true", help="print JSON instead of a table")

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        where = dict(_pair(text) for text in arguments.where)
        folders: list[Path] = arguments.folder
        found = runs(
            folders if len(folders) > 1 else (*folders, OUT)[0],
            scenario=arguments.scenario,
            end=arguments.end,
            where=where,
        )
        if arguments.json:
            content = [run.as_json for run in found]
            if arguments.compare:
                found.compare()  # raises an error for less than two runs
                readable = [run for run in found if "versions" in run.summary]
                first = readable[0].parameters
                different = {key for run in readable for key in changed(first, run.parameters)}
                content = [
                    {**run.as_json, "parameters": {key: run.parameters.get(key) for key in sorted(different)}}
                    for run in readable
                ]  # fmt: skip
            print(json.dumps(content, indent=2))
            return DONE
        # Plain text: the directories stay whole on a narrow terminal and in a pipe.
        print(found.compare() if arguments.compare else found.table)
        return DONE


def _pair(text: str) -> tuple[str, str]:
    target, equals, value = text.partition("=")
    if not equals:
        raise ScenarioError(f"--where {text}: COMPONENT.PARAMETER=VALUE is expected")
    return target.strip(), value.strip()
