"""The frames on the loop's CAN channels, as one more listener hears them, in python-can's own formats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import can
from can.io.blf import FILE_HEADER_SIZE

from freeflyer_adapters.can.link import open_bus
from freeflyer_adapters.recording.frame_times import STAMPED_BY_THE_WALL_CLOCK, FrameTimes
from freeflyer_adapters.recording.header import CanChannel
from freeflyer_adapters.recording.wall_clock import WallClock

FORMATS = ("blf", "asc")
COMPRESSION = 1
"""The fastest: 2000 frames a second are to be a small part of a core."""
BUFFER = 2**20
MOST = 5000
"""Frames at a time: a channel that is busier than this process is fast must not keep it."""


class WholeBlfWriter(can.BLFWriter):
    """python-can writes a container when 128 KiB are there, and the header, which has the time that all frames count from, at the
    end: of a logger that is killed, seconds are lost, and of what is left the date. Here both are written with every `save`.
    """

    def save(self) -> None:
        self._flush()
        size = self.file.tell()
        self.file.seek(0)
        self._write_header(size)
        self.file.seek(max(size, FILE_HEADER_SIZE))
        self.file.flush()


class CanLog:
    """One channel's log. Raises OSError of the file, DeviceError if the bus cannot be opened."""

    def __init__(self, channel: CanChannel, path: Path, clock: WallClock | None = None) -> None:
        """Without `clock`, times are the interface's own in any case."""
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
        """Everything that has come; then to the system, where it outlives this process."""
        frames: list[can.Message] = []
        while len(frames) < MOST and (frame := self._received()) is not None:
            frames.append(frame)
        if self._times is not None:
            frames = self._times.put_right(frames, is_all=len(frames) < MOST)
        for frame in frames:
            # Every format counts channels from one and takes a number only.
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
        try:
            self._writer.stop()
        finally:
            self.leave()

    def leave(self) -> None:
        """The bus alone: who does not listen must not be sent frames."""
        self._bus.shutdown()
