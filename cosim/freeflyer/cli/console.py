"""The console of all commands."""

from __future__ import annotations

import os
import sys

from rich.console import Console


class PlainConsole(Console):
    """A console that discards its output after a broken pipe. The command then continues."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
