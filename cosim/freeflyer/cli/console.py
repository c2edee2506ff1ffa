"""The console of all commands."""

from __future__ import annotations

import os
import sys

from rich import table as rich_table
from rich.console import Console

from freeflyer.foundation.table import Table


class PlainConsole(Console):
    """A console that discards its output after a broken pipe. The command then continues."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def as_rich(table: Table) -> rich_table.Table:
    """Return a table for the console."""
    shown = rich_table.Table(title=table.title, title_justify="left")
    for place, header in enumerate(table.header):
        shown.add_column(header, justify="right" if place else "left")
    for number, row in enumerate(table.rows):
        if number in table.breaks:
            shown.add_section()
        shown.add_row(*row)
    return shown
