"""What a command prints to."""

from __future__ import annotations

import os
import sys

from rich.console import Console


class PlainConsole(Console):
    """A console that goes silent, instead of ending the command, when its reader has gone."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
