"""`freeflyer hil` and `freeflyer facility`."""

from __future__ import annotations

import argparse
import json
import time
from contextlib import closing

from rich.console import Console
from rich.table import Table

from freeflyer.cli.console import as_rich
from freeflyer.foundation.errors import report_error
from freeflyer.foundation.exit_codes import BAD_INPUT, DONE, STOPPED
from freeflyer.foundation.interrupts import interrupts
from freeflyer.foundation.output_file import check_writable, folder, write_text
from freeflyer.scenario import scenario
from freeflyer.scenario.directory_option import add_directory
from freeflyer.scenario.scenario import Scenario
from freeflyer.scenario.verdict import verdict
from freeflyer_adapters.base.notices import notices
from freeflyer_adapters.facility import settings as facility_settings
from freeflyer_adapters.facility.server import Facility
from freeflyer_adapters.foundation import pacing
from freeflyer_adapters.loop import hil
from freeflyer_adapters.loop.stop_notice import check_log_to
from freeflyer_adapters.recording.can_log import FORMATS
from freeflyer_adapters.session import (
    counts_table,
    facility_beside,
    recording_lines,
    run_loop,
    show_faults,
    times_table,
)


class HilCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        _common(parser)
        add_directory(
            parser, "freeflyer_out/hil_SCENARIO-TIME-HASH; freeflyer_out/hil_SCENARIO links to it"
        )
        # The devices: real, or models in this process.
        how = parser.add_mutually_exclusive_group()
        how.add_argument(
            "--simulated",
            action="store_true",
            help="replace every device by its model in this process, in real time",
        )
        how.add_argument(
            "--accelerated",
            action="store_true",
            help="run the virtual facility, its links and its faults in this process, in virtual time, as fast as possible",
        )
        parser.add_argument(
            "--check",
            action="store_true",
            help="configure every device, show the measurements of each device and whether the device could be activated, and exit; nothing moves",
        )
        # The output during the run, and the files.
        parser.add_argument(
            "--view",
            action=argparse.BooleanOptionalAction,
            default=None,
            help="show a live view of the loop (default: yes, if the output is a terminal)",
        )
        parser.add_argument(
            "--record",
            action=argparse.BooleanOptionalAction,
            default=True,
            help="write recording.mcap and the CAN log (default: yes); flight_recording.mcap with the last 2 s is always written",
        )
        parser.add_argument(
            "--log-to",
            metavar="LOG",
            help="also send the reason of the stop to a system log: syslog (/dev/log), syslog:PATH or syslog:HOST:PORT",
        )
        parser.add_argument(
            "--can-log",
            choices=FORMATS,
            default=FORMATS[0],
            help=f"format of the CAN log (default: {FORMATS[0]})",
        )

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        chosen = scenario.load(arguments.scenario, arguments.overrides)
        if arguments.log_to is not None:
            check_log_to(arguments.log_to)
        if arguments.check:
            return _check(facility_settings.with_watchdogs(chosen), arguments, console)

        def show(text: str) -> None:
            console.print(text, soft_wrap=True)

        result = run_loop(
            chosen,
            directory=arguments.out,
            existing=arguments.existing,
            simulated=arguments.simulated,
            virtual=arguments.accelerated,
            real_time=arguments.real_time,
            view=console.is_terminal if arguments.view is None else arguments.view,
            record=arguments.record,
            can_format=arguments.can_log,
            log_to=arguments.log_to,
            fmi=arguments.fmi,
            show=show,
        )
        for problem in result.problems:
            show(problem)
        report = result.report
        for table in (result.table, times_table(report.times), counts_table(report.devices)):
            console.print(as_rich(table))
        for line in result.lines:
            show(line)
        for sentence in (*report.remarks, *recording_lines(report.recording or {})):
            show(sentence)
        return verdict(result.scenario, result.outcome)


class FacilityCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        _common(parser)
        parser.add_argument(
            "--out",
            type=folder,
            metavar="DIR",
            help="write facility.json to this directory at the end",
        )

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        chosen = scenario.load(arguments.scenario, arguments.overrides)
        if arguments.out:
            check_writable(arguments.out)

        def show(text: str) -> None:
            console.print(f"{time.strftime('%H:%M:%S')}  {text}", soft_wrap=True)

        for notice in notices(chosen, as_robot=True):
            show(notice)
        # A thread inherits its priority. So the threads of the links must start before the loop
        # gets its own, higher priority.
        try:
            pacing.prepare_links(arguments.real_time)
            facility = Facility(chosen, arguments.fmi)
            with interrupts(), closing(facility):
                show("real time: " + ", ".join(pacing.enter_real_time(arguments.real_time)))
                show(
                    f"the facility of scenario {chosen.name} is there: {', '.join(d.name for d in facility.devices)}; Ctrl-C ends it"
                )
                show_faults(facility, show)
                with pacing.no_collection():
                    outcome = facility.run(show)
        finally:
            pacing.leave_real_time()
        report = facility.report()
        if arguments.out:
            write_text(arguments.out / "facility.json", json.dumps(report, indent=2) + "\n")
        console.print(as_rich(times_table(report["times"])))
        console.print(as_rich(counts_table(report["devices"])))
        if outcome.failed or outcome.diverged:
            return report_error(f"the facility's model failed: {outcome.cause}", STOPPED)
        return DONE


def _check(chosen: Scenario, arguments: argparse.Namespace, console: Console) -> int:
    """Execute `--check`. Return the exit code.

    The exit code is BAD_INPUT if a device could not be activated now, and DONE otherwise.
    """
    with facility_beside(chosen, arguments.accelerated, arguments.fmi, lambda text: None):
        found = hil.inspect(chosen, simulated=arguments.simulated, fmi=arguments.fmi)
    for name, inspection in found.items():
        table = Table(title=f"{name} measures", title_justify="left")
        for column in ("", "unit", "value"):
            table.add_column(column)
        for variable, values in inspection.measured.items():
            units = list(dict.fromkeys(unit or "" for unit in inspection.units[variable]))
            table.add_row(
                variable.replace("_", " "),
                ", ".join(units),
                "  ".join(f"{value:.5g}" for value in values),
            )
        console.print(table)
    for sentence in hil.limitations({name: i.cannot_refuse for name, i in found.items()}):
        console.print(sentence, soft_wrap=True)
    refusals = [inspection.refusal for inspection in found.values() if inspection.refusal]
    for refusal in refusals:
        report_error(refusal, BAD_INPUT)
    if refusals:
        return BAD_INPUT
    console.print(
        "Every device answers as the scenario expects, and could be activated. Nothing was activated.",
        soft_wrap=True,
    )
    return DONE


def _common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "scenario", metavar="SCENARIO", help=f"{', '.join(scenario.shipped())}, or a .toml file"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest="overrides",
        help="COMPONENT.PARAMETER=VALUE, or devices.NAME.KEY=VALUE",
    )
    parser.add_argument(
        "--fmi", type=int, choices=(2, 3), help="FMI version of the shipped FMUs (default: 2)"
    )
    parser.add_argument(
        "--real-time",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="request SCHED_FIFO and locked memory (default: yes)",
    )
