"""A command line run in this process."""

from __future__ import annotations

import pytest

from freeflyer.cli import main as command


def run_command(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Run a command; return its exit code and its error, which must be at most one line."""
    code = command.call(arguments)
    error = capsys.readouterr().err
    assert "Traceback" not in error
    assert len(error.strip().splitlines()) <= 1, error
    return code, error
