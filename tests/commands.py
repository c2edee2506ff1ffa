"""A command as a user gives it, and what it says."""

from __future__ import annotations

import pytest

from freeflyer.cli import main as command


def run_command(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    code = command.call(arguments)
    error = capsys.readouterr().err
    assert "Traceback" not in error
    assert len(error.strip().splitlines()) <= 1, error
    return code, error
