"""The virtual facility as a process of its own, for a script.

`python -m` with this module runs the command `freeflyer facility`, until the script closes the pipe
on stdin or ends. Therefore no facility remains after a script that was killed.
"""

from __future__ import annotations

import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any, Self

from freeflyer.cli.main import main
from freeflyer.foundation.extras import EXTRAS, require
from freeflyer.foundation.file_name import text_of
from freeflyer.foundation.temporary_folder import TemporaryFolder
from freeflyer.scenario.overrides import Changes
from freeflyer.scenario.scenario import texts
from freeflyer_adapters.foundation.errors import DeviceError

READY = "is there"
START, END = 60.0, 20.0
"""Longest times [s] in which the facility must start and end."""


class VirtualFacility:
    """The virtual facility of a scenario, as `freeflyer facility`: arm and base robot over links.

    It is a context manager. The links are open within the context. `scenario` is the name of a
    shipped scenario or the path of a file; `changes` are those of `freeflyer.load`. `lines` are the
    events so far, as `freeflyer facility` prints them. After the context, `report` is the content
    of facility.json. Raises DeviceError if the facility does not start.
    """

    def __init__(
        self, scenario: str | os.PathLike[str] = "facility", changes: Changes = ()
    ) -> None:
        self._settings = [part for text in texts(changes) for part in ("--set", text)]
        self._scenario = text_of(scenario, "the scenario", DeviceError)
        self.lines: list[str] = []
        self.report: dict[str, Any] = {}

    def __enter__(self) -> Self:
        require("VirtualFacility", EXTRAS["hil"])
        self._folder = TemporaryFolder()
        command = (sys.executable, "-P", "-m", __name__, "facility", self._scenario)
        self._process = subprocess.Popen(
            [*command, *self._settings, "--out", str(self._folder.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,  # Ctrl-C ends the script, which then ends the facility
        )
        self._new: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()
        try:
            self.wait_for(READY, START)
        except BaseException:
            self.__exit__()
            raise
        return self

    def wait_for(self, text: str, timeout: float = 10.0) -> str:
        """Return the next event whose line contains `text`.

        Raises DeviceError if it does not come within `timeout` [s], or if the facility ends.
        """
        end = time.monotonic() + timeout
        while True:
            try:
                line = self._new.get(timeout=max(0.0, end - time.monotonic()))
            except queue.Empty:
                raise DeviceError(
                    f"the facility did not print {text!r} within {timeout:g} s; its last line is {(self.lines or ['(none)'])[-1]!r}"
                ) from None
            if line is None:
                raise DeviceError(
                    f"the facility of scenario {self._scenario} ended: {(self.lines or ['without a message'])[-1]}"
                )
            if text in line:
                return line

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(END)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        assert self._process.stdin is not None
        self._process.stdin.close()
        file = self._folder.path / "facility.json"
        if file.is_file():
            self.report = json.loads(file.read_text(encoding="utf-8"))
        self._folder.remove()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as output:
            for line in output:
                self.lines.append(line.rstrip("\n"))
                self._new.put(self.lines[-1])
        self._new.put(None)


def _facility_of_a_script() -> int:
    """Run the facility. If the script ends first, end in order, and remove the folder."""
    alone = threading.Event()

    def follow() -> None:
        os.read(0, 1)  # returns when the script has closed the pipe, or has ended
        alone.set()
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=follow, daemon=True).start()
    try:
        return main()
    finally:
        if alone.is_set():
            shutil.rmtree(Path(sys.argv[-1]).parent, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(_facility_of_a_script())
