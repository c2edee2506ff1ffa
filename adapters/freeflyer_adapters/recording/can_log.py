"""Log of the frames on the CAN channels of a loop, in file formats of python-can.

The recorder opens each channel itself, as one more node, and receives all frames.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import can
from can.io.blf import FILE_HEADER_SIZE

from freeflyer_adapters.can.link import open_bus
from freeflyer_adapters.recording.frame_times import STAMPED_BY_THE_WALL_CLOCK, FrameTimes
from freeflyer_adapters.recording.ring_header import CanChannel
from freeflyer_adapters.recording.wall_clock import WallClock

FORMATS = ("blf", "asc")
COMPRESSION = 1
"""Fastest level of zlib, so that 2000 frames per second need only a small part of a CPU core."""
BUFFER = 2**20
MOST = 5000
"""Maximum number of frames per call of `take`. So a busy channel cannot block the recorder."""


class WholeBlfWriter(can.BLFWriter):
    """A BLF writer that writes the open container and the file header with every `save`.

    A BLF file consists of containers, which contain the frames. The base class collects 128 KiB of
    frames in the open container before it writes this container. The base class writes the file
    header, with the start time, only at the end. Without `save`, a killed recorder would lose the
    frames of the last seconds, and the start time.
    """

    def save(self) -> None:
        """Write the open container and the file header to disk."""
        self._flush()
        size = self.file.tell()
        self.file.seek(0)
        self._write_header(size)
        self.file.seek(max(size, FILE_HEADER_SIZE))
        self.file.flush()


class CanLog:
    """The log of one channel.

    Raises OSError if the file cannot be written. Raises DeviceError if the bus cannot be opened.
    """

    def __init__(self, channel: CanChannel, path: Path, clock: WallClock | None = None) -> None:
        """Open the bus and the file.

        With `clock`, the frame times of some interfaces are converted to the time scale of the
        recording (see `FrameTimes`). Otherwise the log contains the times that the interface
        reports.
        """
        self.path = path
        self.frames = 0
        self._times: FrameTimes | None = None
        if clock is not None and channel.interface in STAMPED_BY_THE_WALL_CLOCK:
            self._times = FrameTimes(clock)
        self._bus = open_bus(channel.interface, channel.channel, channel.is_fd, [], channel.bus)
        try:
            self._writer: Any
            if path.suffix == ".blf":
                file = path.open("wb", buffering=BUFFER)
                self._writer = WholeBlfWriter(file, compression_level=COMPRESSION)
                self._save = self._writer.save
            else:
                self._writer = can.ASCWriter(path.open("w", encoding="ascii", buffering=BUFFER))
                self._save = self._writer.file.flush
        except BaseException:
            self._bus.shutdown()
            raise

    def take(self) -> None:
        """Write all received frames and flush the file. A killed process loses no flushed frame."""
        frames: list[can.Message] = []
        while len(frames) < MOST and (frame := self._received()) is not None:
            frames.append(frame)
        if self._times is not None:
            frames = self._times.corrected(frames, is_all=len(frames) < MOST)
        for frame in frames:
            # python-can needs a number as the channel, and adds 1 to this number.
            frame.channel = 0
            self._writer.on_message_received(frame)
            self.frames += 1
        if frames:
            self._save()

    def _received(self) -> can.Message | None:
        try:
            return self._bus.recv(0.0)
        except can.CanError:
            return None

    def close(self) -> None:
        """Finish the file and close the bus."""
        try:
            self._writer.stop()
        finally:
            self.close_bus()

    def close_bus(self) -> None:
        """Close only the bus, so that no more frames are queued for this log."""
        self._bus.shutdown()
