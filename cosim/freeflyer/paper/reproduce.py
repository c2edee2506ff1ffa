"""Run the paper's experiments, draw its figures, and compare its statements with the results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib import rc_context
from rich.console import Console
from rich.table import Table

from freeflyer.analysis.audit.audit import audit
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.exit_codes import DONE, STOPPED
from freeflyer.paper import criteria, figures, real_time, report
from freeflyer.paper.report import ASSUMPTIONS, Figure, Statement
from freeflyer.paper.statements import (
    CASES,
    DEFAULT_GAINS,
    FIRMNESS,
    SETS,
    TOGETHER,
    default_statements,
    real_time_statements,
    set_statements,
    statements,
)
from freeflyer.scenario import experiment, scenario
from freeflyer.scenario.experiment import Result
from freeflyer.scenario.figure_style import STYLE, save
from freeflyer.scenario.run_directory import RunDirectory

FIGURES = ("fig[0-9][0-9]*.p[dn][fg]", "overview.p[dn][fg]", "energy_audit_*.p[dn][fg]")
"""Patterns of the figures that `reproduce` writes."""
ATTEMPTS = 3
"""Maximum number of attempts to run a loop in real time."""


def reproduce(
    claimed: RunDirectory, fmi: int, console: Console, *, in_real_time: bool = False
) -> int:
    """Run every case, and write figures, tables and report. Return the exit code.

    `claimed` is the claimed directory of the results, and `fmi` is the FMI version of the FMUs. If
    `in_real_time` is true, the facility experiment is run a second time: in real time on the
    virtual facility, over CAN and Zenoh. After Ctrl-C, the results of all completed cases and of
    the interrupted case are saved.
    Raises OutputError or another CosimError.
    """
    # Run the cases. Stop after a case that was interrupted.
    scenarios = [scenario.load(name) for name in CASES]
    claimed.begin()
    directory = claimed.path
    # With --overwrite: if this reproduction is interrupted, no figure of an earlier one stays.
    for pattern in FIGURES:
        for path in directory.glob(pattern):
            path.unlink()
    results: dict[str, Result] = {}
    with experiment.progress_bar(console, scenarios) as reports:
        for case in scenarios:
            results[case.name] = experiment.run(
                case,
                fmi=fmi,
                progress=reports[case.name],
                directory=directory / case.name,
                existing="overwrite",
            )
            if results[case.name].outcome.interrupted:
                break
    # Run the loops in real time, and write the summary of all runs.
    loops = (
        run_in_real_time(directory, console) if in_real_time and len(results) == len(CASES) else {}
    )
    summaries = {name: result.summary for name, result in {**results, **loops}.items()}
    if len(results) < len(CASES) or any(result.outcome.interrupted for result in results.values()):
        claimed.finish({}, {"cases": summaries})
        console.print(
            f"Interrupted; the cases {', '.join(results)} are saved in {claimed.shown(directory)}. No figures were drawn.",
            soft_wrap=True,
        )
        return STOPPED
    # Write the comparison with the paper.
    stated = statements(results) + real_time_statements(results, loops)
    sections = {
        f"Other assumptions: {text}": set_statements(results, name)
        for name, text in list(SETS.items())[1:]
    } | {"This project's default gains": default_statements(results)}
    drawn = draw(results, directory) + draw_real_time(loops, directory)
    report.write(
        directory / "report.html",
        stated,
        sections,
        (FIRMNESS, TOGETHER),
        drawn,
        {**results, **loops},
    )
    claimed.finish({}, {"cases": summaries})
    console.print(table(stated))
    for title, others in sections.items():
        console.print(f"{title}: {counted(others)}", soft_wrap=True)
    console.print(FIRMNESS, style="dim")
    console.print(ASSUMPTIONS, style="dim")
    console.print(
        f"Report: {claimed.shown(directory / 'report.html')}; figures, records and summary.json are in the same directory",
        soft_wrap=True,
    )
    for note in claimed.notes:
        console.print(note, soft_wrap=True)
    unexpected = [name for name, result in {**results, **loops}.items() if not result.as_expected]
    if unexpected:
        console.print(f"Not as expected: {', '.join(unexpected)}")
    return STOPPED if unexpected else DONE


def run_in_real_time(directory: Path, console: Console) -> dict[str, Result]:
    """Run the facility experiment with and without passivity controllers.

    A machine without a real-time kernel can suspend a process for longer than the watchdogs allow.
    Then the loop stops, although it has no fault. Therefore, if a loop stops early, this is
    reported and the loop is run again. There are at most ATTEMPTS attempts for each loop.
    """
    loops = {}
    for case in map(scenario.load, real_time.CASES):
        for attempt in range(1, ATTEMPTS + 1):
            with console.status(f"{case.name} in real time ({seconds(case.stop):g} s)"):
                result = real_time.run(case, directory / f"{case.name}_real_time")
            loops[f"{case.name}_real_time"] = result
            if result.as_expected or result.outcome.interrupted:
                break
            console.print(
                f"{case.name} in real time, attempt {attempt} of {ATTEMPTS}, stopped at {result.outcome.simulated:.1f} s: "
                f"{result.outcome.cause}",
                soft_wrap=True,
            )
    return loops


def draw_real_time(loops: Mapping[str, Result], directory: Path) -> list[Figure]:
    """Draw the figures of the loops in real time, and return the figures with captions."""
    if not loops:
        return []
    passive, without = (result.outcome.record for result in loops.values())
    setting = "In real time on the virtual facility, over CAN FD and Zenoh (its drives, noise and delay are assumptions)"
    # Each figure has a number, a drawing function, a record and a caption.
    drawings = [
        (
            "11",
            figures.facility_manipulator,
            passive,
            "tracking error of the end-effector (top), force of the manipulator (bottom)",
        ),
        (
            "12",
            figures.facility_base,
            passive,
            "regulation error of the base (top), force on the base (bottom)",
        ),
        (
            "13",
            figures.energies,
            without,
            "without passivity controllers: observed energies of manipulator (top) and base (bottom)",
        ),
        (
            "14",
            figures.energies,
            passive,
            "with passivity controllers: observed energies of manipulator (top) and base (bottom)",
        ),
    ]
    # Write the files fig11_real_time.png to fig14_real_time.png.
    drawn = []
    with rc_context(STYLE):
        for number, drawing, record, caption in drawings:
            path = directory / f"fig{number}_real_time.png"
            save(drawing(record), path)
            drawn.append(
                Figure(
                    number=f"Fig. {number} (real time)", caption=f"{setting}: {caption}.", path=path
                )
            )
    return drawn


def draw(results: Mapping[str, Result], directory: Path) -> list[Figure]:
    """Draw the figures of the paper and the energy audits, and return the figures with captions."""
    sine = results["continuous"].outcome.record
    continuous, unstable, passive = (
        results[f"paper_{run}"].outcome.record for run in criteria.RUNS
    )
    facility, without = (
        results[name].outcome.record for name in ("facility", "facility_without_pc")
    )
    both = "T_m = 1 ms, T_b = 0.3 s"
    line = "The end-effector moves 0.14 m along x in 50 s, then rests"
    inside = "Facility experiment inside one FMI system (T_m = 1 ms, T_b = 4 ms; drives, noise and delay are assumptions)"
    # Each figure has a number, a drawing function, a record and a caption.
    drawings = [
        ("2", figures.trajectory, sine, "Desired end-effector position x and orientation theta of the scenario continuous (amplitudes and frequency are assumptions)."),
        ("3", figures.errors, continuous, f"Both controllers at 1 ms (FMUs): error of the end-effector (top) and of the base (bottom). {line}."),
        ("3 (continuous time)", figures.errors, continuous, "The same loop in continuous time, without sampling: one model-exchange FMU, integrated by DOP853 with relative tolerance 1e-10."),
        ("4", figures.errors, unstable, f"Without passivity controllers, {both}: error of the end-effector (top) and of the base (bottom)."),
        ("7", figures.energies, unstable, f"Observed energies without passivity controllers, {both}: manipulator (top), base (bottom). The energies include E(0)."),
        ("8", figures.corrections, passive, f"Forces and torques of the passivity controllers, {both}: manipulator (top), base (bottom)."),
        ("9", figures.energies, passive, f"Observed energies with passivity controllers, {both}: manipulator (top), base (bottom). The energies include E(0)."),
        ("10", figures.errors, passive, f"With passivity controllers, {both}: error of the end-effector (top) and of the base (bottom)."),
        ("11", figures.facility_manipulator, facility, f"{inside}: tracking error of the end-effector (top), force of the manipulator (bottom)."),
        ("12", figures.facility_base, facility, f"{inside}: regulation error of the base (top), force on the base (bottom)."),
        ("13", figures.energies, without, f"{inside}, without passivity controllers: observed energies of manipulator (top) and base (bottom)."),
        ("14", figures.energies, facility, f"{inside}, with passivity controllers: observed energies of manipulator (top) and base (bottom)."),
    ]  # fmt: skip
    # The overview compares the three cases of the simulation.
    labels = ("both controllers at 1 ms", "base at 0.3 s, no PC", "base at 0.3 s, with PC")
    lines = [
        (label, results[name].outcome.record.time, results[name].errors)
        for label, name in zip(labels, DEFAULT_GAINS, strict=True)
    ]
    overview = directory / "overview.png"
    drawn = [
        Figure(
            number="Overview",
            caption="Errors with this project's default gains and a sustained sine, on one scale.",
            path=overview,
        )
    ]
    # Draw the figures of the paper. The figure in continuous time uses the signals of the component
    # continuous_loop.
    with rc_context(STYLE):
        save(figures.overview(lines), overview)
        for number, drawing, record, caption in drawings:
            exact = number.endswith("time)")
            figure = figures.errors(record, "continuous_loop") if exact else drawing(record)
            path = directory / (
                "fig03_continuous_time.png" if exact else f"fig{int(number):02d}.png"
            )
            save(figure, path)
            drawn.append(Figure(number=f"Fig. {number}", caption=caption, path=path))
    # Draw the energy audits.
    for name in DEFAULT_GAINS[1:]:
        record = results[name].outcome.record
        path = directory / f"energy_audit_{name}.png"
        save(audit(record).plot(), path)
        caption = f"Energy audit of {name} (not in the paper): powers, balance, energy sources and sinks, observed and true energy."
        drawn.append(Figure(number="Energy audit", caption=caption, path=path))
    return drawn


def counted(stated: list[Statement]) -> str:
    """Return how many statements have each verdict, for the console."""
    verdicts = [statement.verdict for statement in stated]
    return ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))


def table(stated: list[Statement]) -> Table:
    """Return the statements as a table for the console."""
    shown = Table(
        title="The paper's statements and the measured results",
        title_justify="left",
        show_lines=True,
    )
    for header, share in (("where", 3), ("paper", 5), ("measured", 12), ("", 3)):
        shown.add_column(header, overflow="fold", ratio=share)
    for s in stated:
        shown.add_row(s.where, s.paper, f"{s.measured}\n{s.remark}".strip(), s.verdict)
    return shown
