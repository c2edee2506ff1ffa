"""What earlier runs have left: rings whose loop and recorder have both died, and recordings that nobody has finished."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from adapters.recording.recording_file import FLIGHT, RECORDING, save_flight
from adapters.recording.ring import RingReader, is_left_behind, left_behind
from adapters.recording.run_head import CanChannel
from cosim.errors import CosimError, RecordError

MAGIC = b"\x89MCAP0\r\n"
"""At a recording's begin, and at its end once it is whole."""


def rescue(directory: Path | None = None) -> Iterator[str]:
    """Saves the last seconds of runs that died without a word; a sentence for each."""
    for path in left_behind(directory):
        try:
            saved = save_ring(path)
        except CosimError as error:
            yield f"the last seconds of an earlier run in {path} could not be saved: {error}"
        else:
            if saved is not None:
                yield f"an earlier run died without a word; its last seconds are in {saved}"


def save_ring(path: Path) -> Path | None:
    """The flight recording of a ring that was left behind, beside the run's other files; the ring is gone then.

    None if the run had no instant. RecordError if somebody still works on it, or it is none.
    """
    if not is_left_behind(path):
        raise RecordError(f"the loop of ring {path} is still running, and saves its last seconds itself when it ends")
    ring = RingReader(path)
    try:
        started = time.strftime("%Y%m%dT%H%M%S", time.localtime(ring.head.started * 1e-9))
        saved = save_flight(ring, "somebody after the run", f"{Path(FLIGHT).stem}_{started}.mcap")
        ring.remove()
        return saved
    finally:
        ring.close()


def set_aside(directory: Path, channels: Sequence[CanChannel], can_format: str) -> None:
    """An unfinished recording of an earlier run in the same directory is renamed, with its CAN log, and not written over."""
    recording = directory / RECORDING
    with contextlib.suppress(OSError):
        with recording.open("rb") as file:
            file.seek(-len(MAGIC), os.SEEK_END)
            if file.read() == MAGIC:
                return
        stamp = time.strftime("%Y%m%dT%H%M%S", time.localtime(recording.stat().st_mtime))
        for name in (RECORDING, f"can.{can_format}", *(f"can_{channel.name}.{can_format}" for channel in channels)):
            path = directory / name
            if path.exists():
                path.rename(path.with_name(f"{path.stem}_{stamp}{path.suffix}"))
