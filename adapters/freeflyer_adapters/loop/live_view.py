"""Live terminal view of a running loop. The view is a separate process that reads shared memory.

The loop only copies numbers into a memory-mapped file. The process of the view cannot block or
delay the loop.
"""

from __future__ import annotations

import json
import mmap
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from freeflyer.foundation.temporary_folder import TemporaryFolder
from freeflyer_adapters.device.device import STATE, LifeCycle

SEQUENCE = struct.Struct("=Q")
HEADER = struct.Struct("=I")
PERIOD = 0.2
"""Refresh period of the view [s]."""


class LiveValues:
    """Writer of the live values, in the process of the loop.

    The constructor writes the title and the names. Later, `write` writes only the values.
    """

    def __init__(self, title: str, names: Sequence[str]) -> None:
        self.names = tuple(names)
        head = json.dumps({"title": title, "names": self.names, "loop": os.getpid()}).encode()
        self._values = struct.Struct(f"={len(names)}d")
        self._first = HEADER.size + len(head)
        self._folder = TemporaryFolder()
        self.path = self._folder.path / "values"
        handle = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o600)
        size = self._first + SEQUENCE.size + self._values.size
        # Allocate the space now. If the disk is full, a write to mapped memory without allocated
        # space raises SIGBUS.
        os.posix_fallocate(handle, 0, size) if hasattr(os, "posix_fallocate") else os.write(
            handle, bytes(size)
        )
        self._memory = mmap.mmap(handle, size)
        os.close(handle)
        self._memory[: self._first] = HEADER.pack(len(head)) + head
        self._sequence = 0
        self.viewer: subprocess.Popen[bytes] | None = None

    def show(self) -> None:
        """Start the viewer on this terminal."""
        self.viewer = subprocess.Popen(
            [sys.executable, "-P", "-m", "freeflyer_adapters.loop.live_view", str(self.path)],
            stdin=subprocess.DEVNULL,
        )

    def write(self, values: Sequence[float]) -> None:
        """Write all values with a seqlock: the sequence number is odd during the write.

        If the number of values is wrong, nothing is written. No error is raised, because the view
        must not stop the loop.
        """
        if len(values) != len(self.names):
            return
        self._sequence += 2
        place = self._first
        SEQUENCE.pack_into(self._memory, place, self._sequence - 1)
        self._values.pack_into(self._memory, place + SEQUENCE.size, *values)
        SEQUENCE.pack_into(self._memory, place, self._sequence)

    def end(self) -> None:
        """Terminate the viewer. Waits for at most 0.5 s."""
        if self.viewer is not None:
            self.viewer.terminate()
            with suppress(subprocess.TimeoutExpired):
                self.viewer.wait(0.5)

    def close(self) -> None:
        self.end()
        if self.viewer is not None:
            try:
                self.viewer.wait(2.0)
            except subprocess.TimeoutExpired:
                self.viewer.kill()
                self.viewer.wait()
        self._memory.close()
        self._folder.remove()


class LiveReader:
    """Reader of the live values, in the process of the viewer."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        (length,) = HEADER.unpack_from(self._memory, 0)
        head = json.loads(self._memory[HEADER.size : HEADER.size + length])
        self.title, self.names, self.loop = (
            str(head["title"]),
            tuple(head["names"]),
            int(head["loop"]),
        )
        self._first = HEADER.size + length
        self._values = struct.Struct(f"={len(self.names)}d")

    def read(self) -> Mapping[str, float]:
        """Return all values of the same `write`, by name.

        Returns an empty mapping before the first `write`, and if a `write` was in progress at each
        of 100 attempts.
        """
        for _ in range(100):
            (before,) = SEQUENCE.unpack_from(self._memory, self._first)
            values = self._values.unpack_from(self._memory, self._first + SEQUENCE.size)
            (after,) = SEQUENCE.unpack_from(self._memory, self._first)
            if before == after and before % 2 == 0:
                return dict(zip(self.names, values, strict=True)) if before else {}
        return {}

    @property
    def loop_lives(self) -> bool:
        return os.getppid() == self.loop


def picture(title: str, values: Mapping[str, float]) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("")
    table.add_column("", justify="right", min_width=12)
    for name, value in values.items():
        shown = LifeCycle(int(value)).name if name.endswith(STATE) else f"{value:.5g}"
        table.add_row(Text(name), Text(shown))
    return table


def main(path: str) -> None:
    """Show the view until the process of the loop ends, or until this process gets SIGTERM."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the loop handles Ctrl-C
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    reader = LiveReader(Path(path))
    with Live(console=Console(), auto_refresh=False, transient=True) as live:
        while reader.loop_lives:
            values = reader.read()
            if values:
                live.update(picture(reader.title, values), refresh=True)
            time.sleep(PERIOD)


if __name__ == "__main__":
    main(sys.argv[1])
