"""The command `freeflyer check`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from freeflyer.analysis.sweep import boundary
from freeflyer.analysis.sweep import file as sweep_file
from freeflyer.analysis.sweep.keys import SWEEP, sweep_schema
from freeflyer.analysis.sweep.plan import Plan
from freeflyer.cli.console import as_rich
from freeflyer.cli.run import SCENARIO_HELP, add_fmi, add_overrides
from freeflyer.foundation import toml_file
from freeflyer.foundation.errors import ScenarioError
from freeflyer.foundation.exit_codes import DONE
from freeflyer.scenario import assemble, metrics, scenario
from freeflyer.scenario.keys import SCENARIO
from freeflyer.scenario.schema import scenario_schema

SCHEMAS = {"scenario": scenario_schema, "sweep": sweep_schema}


class CheckCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        sweeps = ", ".join(sweep_file.shipped())
        parser.add_argument(
            "file",
            metavar="SCENARIO_OR_SWEEP",
            nargs="?",
            help=f"a scenario: {SCENARIO_HELP}; or a sweep: {sweeps}, or a .toml file",
        )
        add_overrides(parser)
        add_fmi(parser)
        parser.add_argument(
            "--schema", choices=SCHEMAS, help="print the JSON Schema of scenario or sweep files"
        )

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        name = arguments.file
        if (name is None) == (arguments.schema is None):
            raise ScenarioError("either a scenario or sweep, or --schema is expected")
        if name is None:
            console.out(json.dumps(SCHEMAS[arguments.schema](), indent=1), highlight=False)
            return DONE
        check = check_sweep if is_sweep(name) else check_scenario
        check(name, arguments.overrides, arguments.fmi, console)
        console.print("No mistakes found")
        return DONE


def is_sweep(name: str) -> bool:
    """Return whether `name` is a shipped sweep, or a file with a key that only sweeps have."""
    if not name.endswith(".toml"):
        return name in sweep_file.shipped()
    try:
        return not (SWEEP.keys() - SCENARIO.keys()).isdisjoint(toml_file.read(Path(name)))
    except (OSError, ValueError):
        return False  # the reader of scenarios reports the reason


def check_scenario(name: str, overrides: Sequence[str], fmi: int | None, console: Console) -> None:
    """Load a scenario, initialise its components, and print a summary. Raises CosimError."""
    chosen = scenario.load(name, overrides)
    assemble.check_devices(chosen)
    with assemble.assembled(chosen, fmi) as (master, _):
        metrics.check(chosen, master.graph.components)
    console.print(as_rich(chosen.table))
    for spec in chosen.devices:
        console.print(f"Device for freeflyer hil: {spec.name}, {spec.kind}", soft_wrap=True)


def check_sweep(name: str, overrides: Sequence[str], fmi: int | None, console: Console) -> None:
    """Check the plan of a sweep, and print a summary. Raises CosimError."""
    plan = Plan(sweep_file.read(name, overrides), fmi)
    boundary.check(plan)
    console.print(
        f"Sweep {plan.sweep.name}: {plan.sweep.title} ({len(plan.designs)} designs, {len(plan.sweep.cases)} cases, {len(plan)} runs of {plan.sweep.scenario})",
        soft_wrap=True,
    )
    for axis in plan.axes:
        console.print(f"Varied: {', '.join(map(str, axis.targets))}", soft_wrap=True)
