"""Audit of a recorded run: where its energy entered, and where it was dissipated."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from freeflyer.analysis.audit import recorded_loop, report
from freeflyer.analysis.audit.ledger import Ledger, ledger
from freeflyer.foundation.errors import OutputError, RecordError, UnusableOutput
from freeflyer.foundation.file_name import text_of
from freeflyer.foundation.output_file import staged, write_text
from freeflyer.foundation.table import Shown, Table
from freeflyer.master.record import Record
from freeflyer.scenario import run_state
from freeflyer.scenario.experiment import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True, repr=False)
class Audit(Shown, Ledger):
    """Result of `audit`: the ports `base` and `manipulator`, and the energy `balance` (or None).

    Energies [J] flow into the robot; `time` [s] has the shape (n). `notes` are the limitations of
    this audit. `record_sha256` is `Record.digest` of the audited record. docs/energy_audit.md
    explains every member.
    """

    record_sha256: str

    @property
    def table(self) -> Table:
        """Energies that flowed into the robot at each port."""
        return report.table(self)

    @property
    def observers(self) -> Table:
        """Observed and true energies."""
        return report.observers(self)

    @property
    def summary(self) -> dict[str, Any]:
        """The content of energy_audit.json."""
        return report.numbers(self)

    def plot(self) -> Figure:
        """Return the figure of energy_audit.png, four panels over time."""
        from freeflyer.analysis.audit import figure

        return figure.draw(self)

    def write(self, directory: str | os.PathLike[str]) -> None:
        """Write energy_audit.png, energy_audit.pdf and energy_audit.json.

        Raises OutputError if a file cannot be written, or if the directory has another record.
        """
        from freeflyer.scenario.figure_style import save

        folder = Path(text_of(directory, "the directory", OutputError))
        try:
            with staged(folder) as stage:
                self._check(folder)
                save(self.plot(), stage / "energy_audit.png")
                content = {**self.summary, "record_sha256": self.record_sha256}
                write_text(stage / "energy_audit.json", json.dumps(content, indent=2) + "\n")
                self._check(folder)  # another run may have replaced the record meanwhile
        except OSError as error:
            raise UnusableOutput(f"the audit cannot be written to {folder}: {error.strerror or error}") from error  # fmt: skip

    def _check(self, folder: Path) -> None:
        """Raise OutputError if the folder belongs to another run, or to one that still runs."""
        path, reason = folder / run_state.RECORD, None
        if run_state.state(folder) in ("running", "incomplete"):
            user = run_state.owner(folder)
            reason = "an incomplete run" if user is None else f"a run that is in use by {user}"
        elif path.exists() and Record.read(path).digest != self.record_sha256:
            reason = "the record of another run than the audited one"
        if reason:
            raise UnusableOutput(f"the audit cannot be written to {folder}: it has {reason}; choose another directory")  # fmt: skip


def audit(source: Result | Record | str | os.PathLike[str]) -> Audit:
    """Compute where the energy of a recorded run entered, and where it was dissipated.

    `source` is the result of `run`, its record, or the path of a directory or of a record.parquet
    that `freeflyer run` wrote. The equations are in docs/energy_audit.md. Raises RecordError if
    there is no such record, or if it does not contain the signals of both controllers.
    """
    if isinstance(source, Result):
        source = source.record
    record = (
        source
        if isinstance(source, Record)
        else report.read(Path(text_of(source, "the record", RecordError)))
    )
    return Audit(**vars(ledger(recorded_loop.find(record))), record_sha256=record.digest)
