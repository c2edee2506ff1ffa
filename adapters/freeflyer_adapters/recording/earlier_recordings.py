"""Renaming or removal of earlier recordings in the directory of a new run."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Sequence
from pathlib import Path

from freeflyer_adapters.recording.damaged_mcap import MAGIC
from freeflyer_adapters.recording.mcap_file import RECORDING
from freeflyer_adapters.recording.parts import number_of, parts
from freeflyer_adapters.recording.ring_header import CanChannel


def set_aside(directory: Path, channels: Sequence[CanChannel], can_format: str) -> None:
    """Prepare the directory of a run for a new recording.

    A recording consists of one or more MCAP files, its parts. If an earlier recording in this
    directory is unfinished, all its parts and its CAN logs are renamed. If the earlier recording is
    finished, its parts are removed, so that they cannot be confused with the parts of the new run.

    `channels`, `can_format`: CAN channels and format of the CAN logs. They determine the file names
    of the logs.
    """
    with contextlib.suppress(OSError):
        found = parts(directory)
        if all(_is_finished(path) for path in found):
            for path in found:
                path.unlink()
            return
        stamp = time.strftime("%Y%m%dT%H%M%S", time.localtime(found[-1].stat().st_mtime))
        first = directory / RECORDING
        for path in found:
            number = "" if path == first else f"_{number_of(path)}"
            path.rename(first.with_name(f"{first.stem}_{stamp}{number}{first.suffix}"))
        for name in (
            f"can.{can_format}",
            *(f"can_{channel.name}.{can_format}" for channel in channels),
        ):
            path = directory / name
            if path.exists():
                path.rename(path.with_name(f"{path.stem}_{stamp}{path.suffix}"))


def _is_finished(path: Path) -> bool:
    """Return whether the file ends with the magic bytes of MCAP."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - len(MAGIC)))
        return size > len(MAGIC) and file.read() == MAGIC
