"""What earlier runs have left: rings whose loop and recorder have both died, and recordings that nobody has finished."""

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
    """`flight`: the last seconds; None if the run had no instant. `rest`: the end of its recording, if that was missing."""

    flight: Path | None
    rest: Path | None


def rescue(directory: Path | None = None) -> Iterator[str]:
    """Saves the last seconds of runs that died without a word; a sentence for each."""
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
                yield f"an earlier run died without a word; its last seconds are in {saved.flight}{rest}"


def save_ring(path: Path) -> Saved:
    """Of a ring that was left behind: the flight recording, and what the recording lacks, beside the run's other files; the ring is
    gone then. RecordError if somebody still works on it, or it is none.
    """
    if not is_left_behind(path):
        raise RecordError(
            f"the loop of ring {path} is still running, and saves its last seconds itself when it ends"
        )
    ring = RingReader(path)
    try:
        started = time.strftime("%Y%m%dT%H%M%S", time.localtime(ring.head.started * 1e-9))
        flight = save_flight(ring, "somebody after the run", f"{Path(FLIGHT).stem}_{started}.mcap")
        try:
            rest = save_rest(ring, "somebody after the run")
        except OSError as error:
            raise OutputError(
                f"the end of the recording in {ring.head.directory} cannot be written: {error.strerror}"
            ) from error
        ring.remove()
        return Saved(flight=flight, rest=rest)
    finally:
        ring.close()


def set_aside(directory: Path, channels: Sequence[CanChannel], can_format: str) -> None:
    """An unfinished recording of an earlier run in the same directory is renamed, all its parts and its CAN log, and not written over.

    Of a finished one, which is, the further parts are removed, so that nobody takes them for the new run's.
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
    """Whether its end is there, which looks like its begin."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - len(MAGIC)))
        return size > len(MAGIC) and file.read() == MAGIC
