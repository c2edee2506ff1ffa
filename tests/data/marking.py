"""Component for tests of sweeps: it records that it ran, sleeps, and can kill its process."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from freeflyer.fmi.component import Port, PythonComponent


def parameter(name: str) -> Port:
    return Port(name=name, size=1, causality="parameter", units=("1",), start=(0.0,), settable=True)


class Marking(PythonComponent):
    """`y` is `x` squared after a step of `nap` seconds; `x` equal to `deadly` kills the process."""

    def __init__(self, name: str) -> None:
        output = Port(name="y", size=1, causality="output", units=("1",))
        super().__init__(name, [parameter("x"), parameter("nap"), parameter("deadly"), output])

    def advance(self, now: float, size: float) -> None:
        x, nap, deadly = (float(self.values[name][0]) for name in ("x", "nap", "deadly"))
        time.sleep(nap)
        if x == deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        with (Path(os.environ["MARKS"]) / f"{x:g}").open("a") as mark:
            mark.write(f"{os.getpid()}\n")
        self.values["y"][:] = x * x


def make(name: str) -> Marking:
    return Marking(name)
