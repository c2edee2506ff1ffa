"""`freeflyer hil` and `freeflyer facility`."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from freeflyer.cli.run import result_table
from freeflyer.foundation.errors import report_error
from freeflyer.foundation.exit_codes import BAD_INPUT, DONE, STOPPED
from freeflyer.foundation.interrupts import interrupts
from freeflyer.foundation.output_file import check_writable, folder, write_text
from freeflyer.scenario import experiment, scenario
from freeflyer.scenario.scenario import Scenario
from freeflyer.scenario.verdict import verdict
from freeflyer_adapters.base.notices import notices
from freeflyer_adapters.facility import settings as facility_settings
from freeflyer_adapters.facility.accelerated import accelerated
from freeflyer_adapters.facility.server import Facility
from freeflyer_adapters.foundation import pacing
from freeflyer_adapters.loop import hil
from freeflyer_adapters.loop.graded_stop import NOTHING_ACTIVE
from freeflyer_adapters.loop.stop_notice import StopNotice, check_log_to
from freeflyer_adapters.recording.can_log import FORMATS
from freeflyer_adapters.recording.client import Recording
from freeflyer_adapters.recording.ring_recovery import rescue

AFTERWARDS = 1.0
"""Virtual time for the devices to come to rest, after the controllers have ended [s]."""


class HilCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        _common(parser)
        parser.add_argument(
            "--out",
            type=folder,
            metavar="DIR",
            help="directory of the results (default: freeflyer_out/hil_SCENARIO)",
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
        chosen = facility_settings.with_watchdogs(chosen)
        if arguments.log_to is not None:
            check_log_to(arguments.log_to)
        if arguments.check:
            return _check(chosen, arguments, console)
        # Check the output directory and print all notices before the link of a device is opened.
        directory = arguments.out or Path("freeflyer_out") / f"hil_{chosen.name}"
        check_writable(directory)
        if not arguments.simulated:
            for notice in notices(chosen, as_robot=False):
                console.print(notice, soft_wrap=True)
        view = console.is_terminal if arguments.view is None else arguments.view

        def show(text: str) -> None:
            console.print(text, soft_wrap=True)

        # First complete the recordings of earlier runs that were killed.
        for sentence in rescue():
            show(sentence)
        recording = Recording(
            directory=directory,
            everything=arguments.record,
            can=not arguments.accelerated,
            can_format=arguments.can_log,
        )
        stop = StopNotice(
            directory=directory, log_to=arguments.log_to, scenario=chosen.name, show=show
        )
        with closing(stop), _facility_beside(chosen, arguments, show), _reason_kept(stop):
            result, report = hil.run(
                chosen,
                real_time=arguments.real_time and not arguments.accelerated,
                simulated=arguments.simulated,
                view=view and not arguments.accelerated,
                fmi=arguments.fmi,
                recording=recording,
                notice=stop,
                show=show,
            )
        # The results are written after the stop.
        for problem in stop.problems:
            show(problem)
        experiment.write(result, directory)
        console.print(result_table(result))
        console.print(times_table(report.times))
        console.print(counts_table(report.devices))
        console.print(
            f"Results in {directory}: record.parquet, summary.json, stop.json", soft_wrap=True
        )
        for sentence in (*report.remarks, *recording_lines(report.recording or {})):
            console.print(sentence, soft_wrap=True)
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
        console.print(times_table(report["times"]))
        console.print(counts_table(report["devices"]))
        if outcome.failed or outcome.diverged:
            return report_error(f"the facility's model failed: {outcome.cause}", STOPPED)
        return DONE


def _check(chosen: Scenario, arguments: argparse.Namespace, console: Console) -> int:
    """Execute `--check`. Return the exit code.

    The exit code is BAD_INPUT if a device could not be activated now, and DONE otherwise.
    """
    with _facility_beside(chosen, arguments, lambda text: None):
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


@contextmanager
def _reason_kept(stop: StopNotice) -> Iterator[None]:
    """If a run ends with an exception, write the reason to stop.json and the system log.

    If the run itself has already written the reason, nothing is written here. A run that ends
    before its devices are prepared has not written the reason. The reason is not printed here,
    because the command prints the error.
    """
    try:
        yield
    except BaseException as error:
        stop.give(
            hil.reason_of(error),
            NOTHING_ACTIVE,
            orderly=isinstance(error, KeyboardInterrupt),
            quiet=True,
        )
        raise


@contextmanager
def _facility_beside(
    chosen: Scenario, arguments: argparse.Namespace, show: Callable[[str], None]
) -> Iterator[None]:
    """With `--accelerated`, run the facility in this process, in the virtual time of the loop."""
    if not arguments.accelerated:
        yield
        return
    with accelerated(chosen, arguments.fmi, show) as both:
        show_faults(both.facility, show)
        yield
        both.time.sleep(AFTERWARDS)


def show_faults(facility: Facility, show: Callable[[str], None]) -> None:
    for fault in facility.settings.faults:
        show(f"fault: {fault.one_line()}")


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


def recording_lines(recording: Mapping[str, Any]) -> list[str]:
    """Return messages about the files of a recording and about missing data.

    `recording` is the value of `LoopReport.recording`, or an empty mapping.
    """
    paths = [*recording.get("recording", ()), *recording.get("can", ()), recording.get("flight")]
    lines = [f"Recorded: {', '.join(path for path in paths if path)}"] if any(paths) else []
    if recording.get("rows_lost"):
        lines.append(
            f"The recorder was delayed: {recording['rows_lost']} instants are missing in the recording"
        )
    return [
        *lines,
        *recording.get("clock_steps", ()),
        *(f"Missing: {sentence}" for sentence in recording.get("missing", ())),
    ]


def times_table(times: Mapping[str, Mapping[str, float]]) -> Table:
    table = Table(title="Times [us]", title_justify="left")
    for column in ("", "count", "p50", "p99", "p99.9", "longest"):
        table.add_column(column, justify="left" if not column else "right")
    for name, t in times.items():
        shown = (t[key] for key in ("p50_us", "p99_us", "p999_us", "max_us"))
        table.add_row(name, f"{t['count']:.0f}", *(f"{value:.0f}" for value in shown))
    return table


def counts_table(devices: Mapping[str, Mapping[str, float]]) -> Table:
    table = Table(title="Counts", title_justify="left")
    table.add_column("")
    table.add_column("", justify="right")
    for device, counts in devices.items():
        for name, count in counts.items():
            table.add_row(f"{device}: {name.replace('_', ' ')}", f"{count:.0f}")
    return table
