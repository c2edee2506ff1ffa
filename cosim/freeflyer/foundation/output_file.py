"""Write result files whole or not at all."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Callable
from pathlib import Path

from freeflyer.foundation.errors import BAD_INPUT, OutputError


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write(partial_path)` and move the result into place, so that no half-written file is taken for a whole one."""
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(partial)
        os.replace(partial, path)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(
            OSError
        ):  # nothing half-written stays, whatever interrupted the writing
            partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    write_whole(path, lambda partial: Path(partial).write_text(text, encoding="utf-8"))


def check_writable(directory: Path) -> None:
    """OutputError before a long run rather than after it."""
    probe = directory / ".writable"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        failure = OutputError(
            f"output directory {directory} cannot be written: {error.strerror or error}"
        )
        failure.exit_code = BAD_INPUT
        raise failure from error


def folder(text: str) -> Path:
    """Convert the argument of `--out`. Raises ArgumentTypeError for an empty name."""
    if not text:
        raise argparse.ArgumentTypeError("a directory is expected, got an empty name")
    return Path(text)
