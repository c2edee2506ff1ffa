"""Ctrl-C and SIGTERM as something to look at between two steps, in place of an exception in the middle of one."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that end a run in order; one that is ignored (nohup) stays so."""
_noted: list[list[float]] = []
"""The list of the outermost `interrupts`, while there is one."""


@contextmanager
def interrupts() -> Iterator[list[float]]:
    """Ctrl-C and SIGTERM as a list that fills, so that a run ends between two instants. Nested ones share one list: what came
    before a run began ends it at its first instant.

    Another one, more than two seconds after the first, interrupts for good: somebody waits for a component that hangs.
    """
    if _noted:
        yield _noted[0]
        return
    seen: list[float] = []
    if threading.current_thread() is not threading.main_thread():
        yield seen
        return

    def note(number: int, frame: object) -> None:
        seen.append(time.monotonic())
        if seen[-1] - seen[0] > 2.0:
            raise KeyboardInterrupt

    before = {
        number: signal.signal(number, note)
        for number in ENDING
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    _noted.append(seen)
    try:
        yield seen
    finally:
        _noted.clear()
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def no_interrupts() -> Iterator[None]:
    """Nothing of the kind reaches the block, which must be short: the stop of devices is not stopped."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
