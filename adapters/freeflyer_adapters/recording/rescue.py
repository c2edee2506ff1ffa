"""Rescue of data of earlier runs: rings without loop and recorder, and unfinished recordings."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from freeflyer.foundation.errors import CosimError, OutputError, RecordError
from freeflyer_adapters.recording.damaged_mcap import MAGIC
from freeflyer_adapters.recording.header import CanChannel
from freeflyer_adapters.recording.parts import number_of, parts, save_rest
from freeflyer_adapters.recording.recording_file import FLIGHT, RECORDING, save_flight
from freeflyer_adapters.recording.ring import RingReader, is_left_behind, left_behind


@dataclass(frozen=True, kw_only=True)
class Saved:
    """Files that were written from a ring.

    `flight`: the flight recording; None if the ring has no row. `rest`: the missing end of the
    recording; None if nothing was missing.
    """

    flight: Path | None
    rest: Path | None


def rescue(directory: Path | None = None) -> Iterator[str]:
    """Save the last seconds of runs that were killed; yield a message for each."""
    for path in left_behind(directory):
        try:
            saved = save_ring(path)
        except CosimError as error:
            yield f"the last seconds of an earlier run in {path} could not be saved: {error}"
        else:
            if saved.flight is not None:
                rest = (
                    f", the end of its recording in {saved.rest}" if saved.rest is not None else ""
                )
                yield f"an earlier run ended without a reported reason; its last seconds are in {saved.flight}{rest}"


def save_ring(path: Path) -> Saved:
    """Write the flight recording and the missing end of the recording; then remove the ring.

    The files are in the directory of the run. Raises RecordError if the file is not a ring or is in
    use, OutputError if a file cannot be written.
    """
    if not is_left_behind(path):
        raise RecordError(
            f"the loop of ring {path} is still running; its last seconds are saved when it ends"
        )
    ring = RingReader(path)
    try:
        started = time.strftime("%Y%m%dT%H%M%S", time.localtime(ring.head.started * 1e-9))
        flight = save_flight(ring, "recovery after the run", f"{Path(FLIGHT).stem}_{started}.mcap")
        try:
            rest = save_rest(ring, "recovery after the run")
        except OSError as error:
            raise OutputError(
                f"the end of the recording in {ring.head.directory} cannot be written: {error.strerror}"
            ) from error
        ring.remove()
        return Saved(flight=flight, rest=rest)
    finally:
        ring.close()


def set_aside(directory: Path, channels: Sequence[CanChannel], can_format: str) -> None:
    """Prepare the directory of a run for a new recording.

    An unfinished recording of an earlier run is renamed: all its parts and its CAN log. The parts
    of a finished one are removed, so that they cannot be confused with parts of the new run.
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
