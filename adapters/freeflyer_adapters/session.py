"""Run the controllers of a scenario on its devices, with all files of such a run."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from freeflyer.foundation.errors import OutputError
from freeflyer.foundation.table import Table
from freeflyer.scenario.experiment import Result, claim
from freeflyer.scenario.overrides import Changes
from freeflyer.scenario.run_directory import Existing
from freeflyer.scenario.scenario import Scenario, loaded
from freeflyer_adapters.base.notices import notices
from freeflyer_adapters.facility import settings as facility_settings
from freeflyer_adapters.facility.accelerated import accelerated
from freeflyer_adapters.facility.server import Facility
from freeflyer_adapters.foundation.errors import DeviceError
from freeflyer_adapters.loop import hil
from freeflyer_adapters.loop.graded_stop import NOTHING_ACTIVE
from freeflyer_adapters.loop.hil import LoopReport
from freeflyer_adapters.loop.stop_notice import StopNotice, check_log_to
from freeflyer_adapters.recording.can_log import FORMATS
from freeflyer_adapters.recording.client import Recording
from freeflyer_adapters.recording.ring_recovery import rescue

AFTERWARDS = 1.0
"""Virtual time for the devices to come to rest, after the controllers have ended [s]."""
Show = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, repr=False)
class LoopResult(Result):
    """Results of a run with devices.

    `report` has the measured times [us], the counters of the devices and the reason of the stop.
    `directory` contains the files of the run. `problems` are sentences about a reason of the stop
    that could not be written. `lines` are sentences about the directory.
    """

    report: LoopReport
    directory: Path
    problems: Sequence[str]
    lines: Sequence[str] = ()


def run_loop(
    scenario: Scenario | str | os.PathLike[str],
    changes: Changes = (),
    *,
    directory: str | os.PathLike[str] | None = None,
    existing: Existing | None = None,
    simulated: bool = False,
    virtual: bool = False,
    real_time: bool = True,
    view: bool = False,
    record: bool = True,
    can_format: str = FORMATS[0],
    log_to: str | None = None,
    fmi: int | None = None,
    show: Show = print,
) -> LoopResult:
    """Activate the devices of a scenario, run its controllers on them, and stop the devices.

    Real devices get power and move, unless `simulated` (their models run in this process, in real
    time) or `virtual` (the virtual facility, its links and its faults run in this process, in
    virtual time) is true. Read docs/safety.md first. `scenario` and `changes` are those of
    `freeflyer.run`. `directory` (default: freeflyer_out/hil_NAME-TIME-HASH) receives
    record.parquet, summary.json and stop.json, and with `record` also recording.mcap and the CAN
    log in `can_format`. For `existing`, see `freeflyer.Result.save`. `real_time` requests
    SCHED_FIFO and locked memory. `view` opens the live view. `log_to` also sends the reason of the
    stop to a system log. `fmi` is the FMI version of the shipped FMUs. `show` receives one line of
    text for each event. Ctrl-C stops the devices in order.

    Raises CosimError for an error before anything moves. A later error ends the run without an
    exception; it is the cause of the stop.
    """
    if simulated and virtual:
        raise DeviceError("the loop is both simulated and virtual; one of the two is expected")
    if can_format not in FORMATS:
        raise DeviceError(f"can_format is {can_format!r}; {' or '.join(FORMATS)} is expected")
    chosen = facility_settings.with_watchdogs(loaded(scenario, changes))
    if log_to is not None:
        check_log_to(log_to)
    # Check the output directory and show all notices before the link of a device is opened.
    claimed = claim(chosen, directory, existing, f"hil_{chosen.name}")
    try:
        if not simulated:
            for notice in notices(chosen, as_robot=False):
                show(notice)
        # First complete the recordings of earlier runs that were killed.
        for sentence in rescue():
            show(sentence)
        claimed.begin()
        recording = Recording(
            directory=claimed.path, everything=record, can=not virtual, can_format=can_format
        )
        stop = StopNotice(directory=claimed.path, log_to=log_to, scenario=chosen.name, show=show)
        with closing(stop), facility_beside(chosen, virtual, fmi, show), _reason_kept(stop):
            result, report = hil.run(
                chosen,
                real_time=real_time and not virtual,
                simulated=simulated,
                view=view and not virtual,
                fmi=fmi,
                directory=claimed,
                recording=recording,
                notice=stop,
                show=show,
            )
    except BaseException:
        claimed.abandon()  # stop.json and recordings stay
        raise
    found = LoopResult(
        scenario=result.scenario,
        outcome=result.outcome,
        errors=result.errors,
        summary=result.summary,
        report=report,
        directory=claimed.path,
        problems=stop.problems,
    )
    try:
        found.finish(claimed)
    except OutputError:
        claimed.leave()
        raise
    return replace(found, directory=claimed.path, lines=list(claimed.lines))


@contextmanager
def _reason_kept(stop: StopNotice) -> Iterator[None]:
    """If a run ends with an exception, write the reason to stop.json and the system log.

    If the run itself has already written the reason, nothing is written here. A run that ends
    before its devices are prepared has not written the reason. The reason is not shown here,
    because the caller gets the exception.
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
def facility_beside(
    scenario: Scenario, virtual: bool, fmi: int | None, show: Show
) -> Iterator[None]:
    """If `virtual`, run the facility in this process, in the virtual time of the loop."""
    if not virtual:
        yield
        return
    with accelerated(scenario, fmi, show) as both:
        show_faults(both.facility, show)
        yield
        both.time.sleep(AFTERWARDS)


def show_faults(facility: Facility, show: Show) -> None:
    for fault in facility.settings.faults:
        show(f"fault: {fault.one_line()}")


def recording_lines(recording: Mapping[str, Any]) -> list[str]:
    """Return messages about the files of a recording and about missing data.

    `recording` is `LoopReport.recording`, or an empty mapping.
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


def times_table(times: hil.Times) -> Table:
    """Return the table of measured durations."""
    keys = ("p50_us", "p99_us", "p999_us", "max_us")
    return Table(
        title="Times [us]",
        header=("", "count", "p50", "p99", "p99.9", "longest"),
        rows=[
            (name, f"{t['count']:.0f}", *(f"{t[key]:.0f}" for key in keys))
            for name, t in times.items()
        ],
    )


def counts_table(devices: hil.Times) -> Table:
    """Return the table of the counters of all devices."""
    return Table(
        title="Counts",
        header=("", ""),
        rows=[
            (f"{device}: {name.replace('_', ' ')}", f"{count:.0f}")
            for device, counts in devices.items()
            for name, count in counts.items()
        ],
    )
