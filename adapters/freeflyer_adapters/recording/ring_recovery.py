"""Recovery of the rings that killed loops have left in shared memory.

A ring is a ring buffer with the last seconds of a loop (`freeflyer_adapters.recording.ring`). The
flight recording is a file with these last seconds. The recording is another file, which contains
the whole run.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from freeflyer.foundation.errors import CosimError, OutputError, RecordError
from freeflyer_adapters.recording.mcap_file import FLIGHT, save_flight
from freeflyer_adapters.recording.parts import save_rest
from freeflyer_adapters.recording.ring import RingReader, is_left_behind, left_behind


@dataclass(frozen=True, kw_only=True)
class Saved:
    """Files that were written from a ring.

    `flight`: the flight recording, or None if the ring has no row. `rest`: file with the end of the
    recording, which only the ring contained. It is None if the recording was complete.
    """

    flight: Path | None
    rest: Path | None


def rescue(directory: Path | None = None) -> Iterator[str]:
    """Save the data of all rings that no process uses. Yield one message for each run.

    `directory`: the directory of the rings. By default, it is the directory of the user.
    """
    for path in left_behind(directory):
        try:
            saved = save_ring(path)
        except CosimError as error:
            yield f"the last seconds of an earlier run in {path} could not be saved: {error}"
        else:
            if saved.flight is not None:
                rest = (
                    f", and the end of its recording in {saved.rest}"
                    if saved.rest is not None
                    else ""
                )
                yield f"an earlier run ended without a reported reason; its last seconds are in {saved.flight}{rest}"


def save_ring(path: Path) -> Saved:
    """Write the flight recording, and the end of the recording if it is missing. Remove the ring.

    The files are written to the directory of the run. Raises RecordError if the file is not a ring,
    or if the ring is in use. Raises OutputError if a file cannot be written.
    """
    if not is_left_behind(path):
        raise RecordError(
            f"the loop of ring {path} is still running; the last seconds are saved when the loop ends"
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
