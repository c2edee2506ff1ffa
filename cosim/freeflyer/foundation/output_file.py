"""Atomic writing of result files: a complete file or none."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Callable
from pathlib import Path

from freeflyer.foundation.errors import BAD_INPUT, OutputError


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write(partial_path)` and move the result into place, so that no partial file remains.

    Raises OutputError if the file cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(partial)
        os.replace(partial, path)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error
    finally:
        # The partial file is removed after any interruption.
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, completely or not at all. Raises OutputError."""
    write_whole(path, lambda partial: Path(partial).write_text(text, encoding="utf-8"))


def check_writable(directory: Path) -> None:
    """Check before a run that results can be written. Raises OutputError with exit code 2."""
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
