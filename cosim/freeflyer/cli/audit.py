"""`freeflyer audit`: the energy audit of a record, as a table, a figure and a file of numbers."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from rich.console import Console
from rich.table import Table

from freeflyer.analysis.audit import figure as audit_figure
from freeflyer.analysis.audit import ledger, recorded_loop
from freeflyer.analysis.audit.ledger import Audit, Port
from freeflyer.analysis.figure_style import save
from freeflyer.fmi.component import Array
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import DONE, RecordError
from freeflyer.foundation.output_file import check_writable, write_text
from freeflyer.master.record import Record

AXES = ("x", "y", "z", "about x", "about y", "about z")
ENTRIES = (
    # key in energy_audit.json, label, field of Port, sign in the sum
    ("feed_forward", "feed-forward (held)", "feed_forward", 1.0),
    ("reference", "control law on the desired motion", "reference", 1.0),
    ("multi_rate", "multi-rate: true F_B minus held F_B", "stale", 1.0),
    ("virtual", "virtual: from sampling the control law", "virtual", 1.0),
    ("spring", "stored in the control law's spring", "stored", -1.0),
    ("damping", "dissipated by the control law's damping", "dissipated", -1.0),
    ("passivity_controller", "absorbed by the passivity controller", "taken", -1.0),
)


class AuditCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "record",
            type=_path,
            metavar="RECORD",
            help="directory that `freeflyer run` wrote, or its record.parquet",
        )
        parser.add_argument("--out", type=_path, metavar="DIR", help="default: beside the record")

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        source: Path = arguments.record
        record = read(source)
        directory: Path = arguments.out or (source if source.is_dir() else source.parent)
        audit = ledger.audit(recorded_loop.find(record))
        check_writable(directory)
        save(audit_figure.draw(audit), directory / "energy_audit.png")
        write_text(directory / "energy_audit.json", json.dumps(numbers(audit), indent=2) + "\n")
        console.print(table(audit))
        console.print(observers(audit))
        for note in audit.notes:
            console.print(f"Note: {note}", soft_wrap=True)
        console.print(
            f"Audit in {directory}: energy_audit.png, energy_audit.pdf, energy_audit.json",
            soft_wrap=True,
        )
        return DONE


def _path(text: str) -> Path:
    if not text:
        raise argparse.ArgumentTypeError("a path is expected, got an empty name")
    return Path(text)


def read(path: Path) -> Record:
    """Read a record with provenance from its file or its directory. Raises RecordError."""
    file = path / "record.parquet" if path.is_dir() else path
    try:
        if not file.is_file():
            raise RecordError(_missing(path))
        record = Record.read(file)
    except (OSError, pa.ArrowException, ValueError, TypeError, LookupError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise RecordError(
            f"{file} cannot be read as a record of `freeflyer run`: {reason}"
        ) from error
    if record.provenance is None:
        raise RecordError(
            f"{file} does not contain its provenance; a record that this version of `freeflyer run` has written is expected"
        )
    return record


def _missing(path: Path) -> str:
    """Return the message for a path without a record, with the records in its subdirectories."""
    if not path.exists():
        return f"{path} does not exist; a directory that `freeflyer run` has written, or its record.parquet, is expected"
    inside = sorted(run.parent.name for run in path.glob("*/record.parquet"))
    named = ", ".join(inside[:6]) + (f" and {len(inside) - 6} more" if len(inside) > 6 else "")
    return f"{path} has no record.parquet" + (
        f"; there is one in {named}" if inside else "; a directory of `freeflyer run` is expected"
    )


def numbers(audit: Audit) -> dict[str, Any]:
    """Return the contents of energy_audit.json.

    Energies [J] are from the first row to the last; positive energy flows into the robot.
    """
    loop, balance = audit.loop, audit.balance
    ports = {"B": audit.base, "M": audit.manipulator}
    return {
        "scenario": loop.provenance.scenario,
        "observer": loop.observer,
        "from_s": float(audit.time[0]),
        "to_s": float(audit.time[-1]),
        "row_every_s": seconds(loop.interval),
        "manipulator_period_s": seconds(loop.manipulator_law.period),
        "base_period_s": seconds(loop.base_law.period),
        "ports": {
            name: {
                "largest_power_w": float(np.abs(port.power).max()),
                "work_j": _last(port.work),
                **{f"{key}_j": _signed(port, field, sign) for key, _, field, sign in ENTRIES},
                "observer": _observation(audit, port),
            }
            for name, port in ports.items()
        },
        "tracking_error_largest_power_w": float(np.abs(audit.tracking_power).max()),
        "balance": balance
        and {
            "kinetic_energy_change_j": _last(balance.kinetic),
            "work_of_base_wrench_j": _last(balance.base_wrench),
            "work_of_joint_torque_j": _last(balance.joint_torque),
            "work_of_others_j": _last(balance.others),
            "moved_j": balance.moved,
            "residual_of_held_j": float(np.abs(balance.residual_of_held).max()),
            "residual_of_ports_j": float(np.abs(balance.residual_of_ports).max()),
        },
        "notes": list(audit.notes),
    }


def _last(values: Array) -> float:
    return float(values[-1])


def _signed(port: Port, field: str, sign: float) -> float:
    return 0.0 + sign * _last(getattr(port, field))


def _observation(audit: Audit, port: Port) -> dict[str, Any]:
    """Return the observed and the true energy of a port.

    The last row is left out, because the observer takes no sample there.
    """
    observed, true = port.observed[:-1], port.absorbed[:-1]
    row, axis = np.unravel_index(int(np.argmin(observed)), observed.shape)
    return {
        "sum_at_end_j": float(observed[-1].sum()),
        "true_sum_at_end_j": float(true[-1].sum()),
        "least_j": float(observed[row, axis]),
        "least_at_s": float(audit.time[row]),
        "least_of": AXES[axis],
        "true_least_j": float(true.min()),
        "largest_gap_of_sum_j": float(np.abs((observed - true).sum(axis=1)).max()),
    }


def table(audit: Audit) -> Table:
    """Return the table of the energy that flowed into the robot, per port; each column adds up."""
    loop, balance = audit.loop, audit.balance
    shown = Table(
        title=f"Energy into the robot [J]: {loop.provenance.scenario}, {audit.time[0]:g} s to {audit.time[-1]:g} s",
        title_justify="left",
    )
    for header in ("", "port B", "port M", "both"):
        shown.add_column(header, justify="right" if header else "left")

    def row(name: str, at_base: float | None, at_end_effector: float | None, both: float) -> None:
        shown.add_row(
            name,
            *(
                "" if value is None else f"{value:.4g}"
                for value in (at_base, at_end_effector, both)
            ),
        )

    # The entries of each port and their sum.
    for _, label, field, sign in ENTRIES:
        at_base, at_end_effector = (
            _signed(audit.base, field, sign),
            _signed(audit.manipulator, field, sign),
        )
        row(label, at_base, at_end_effector, at_base + at_end_effector)
    shown.add_section()
    works = _last(audit.base.work), _last(audit.manipulator.work)
    row("work at the port", *works, sum(works))
    # The balance of the whole robot, which has no columns per port.
    if balance is not None:
        if np.any(balance.others):
            row("work of other forces on the robot", None, None, _last(balance.others))
        row("kinetic energy, change", None, None, _last(balance.kinetic))
        row(
            "residual of the ports, largest",
            None,
            None,
            float(np.abs(balance.residual_of_ports).max()),
        )
        row(
            "residual of the held (F_b, tau), largest",
            None,
            None,
            float(np.abs(balance.residual_of_held).max()),
        )
        row("moved by (F_b, tau), sum of magnitudes", None, None, balance.moved)
    return shown


def observers(audit: Audit) -> Table:
    """Return the table of observed and true energies."""
    shown = Table(
        title=f"Observed energy [J]: observer {audit.loop.observer!r}, E(0) included",
        title_justify="left",
    )
    for header in ("", "port B", "port M"):
        shown.add_column(header, justify="right" if header else "left")
    observations = [_observation(audit, port) for port in (audit.base, audit.manipulator)]
    for label, key in (
        ("sum at the end", "sum_at_end_j"),
        ("true sum at the end", "true_sum_at_end_j"),
        ("least of a degree of freedom", "least_j"),
        ("true least of a degree of freedom", "true_least_j"),
        ("largest error of the sum", "largest_gap_of_sum_j"),
    ):
        shown.add_row(label, *(f"{observed[key]:.4g}" for observed in observations))
    shown.add_row(
        "degree of freedom and time of the least",
        *(f"{observed['least_of']}, {observed['least_at_s']:g} s" for observed in observations),
    )
    return shown
