"""The command `freeflyer audit`: write the energy audit of a record as table, figure and JSON."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from freeflyer.analysis.audit.audit import audit
from freeflyer.cli.console import as_rich
from freeflyer.foundation.exit_codes import DONE


class AuditCommand:
    def configure(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "record",
            type=_path,
            metavar="RECORD",
            help="directory that `freeflyer run` wrote, or its record.parquet",
        )
        parser.add_argument(
            "--out", type=_path, metavar="DIR", help="default: the directory of the record"
        )

    def execute(self, arguments: argparse.Namespace, console: Console) -> int:
        source: Path = arguments.record
        done = audit(source)
        directory: Path = arguments.out or (source if source.is_dir() else source.parent)
        done.write(directory)
        for table in (done.table, done.observers):
            console.print(as_rich(table))
        for note in done.notes:
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
