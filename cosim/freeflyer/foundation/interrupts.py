"""Deferred handling of Ctrl-C and SIGTERM: the master checks for them between two steps."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that end a run in order. A signal that is ignored (nohup) stays ignored."""
_noted: list[list[float]] = []
"""The list of the outermost active `interrupts` context, or empty."""


@contextmanager
def interrupts() -> Iterator[list[float]]:
    """Collect the arrival times [s] of Ctrl-C and SIGTERM in a list, so that a run ends between two
    instants.

    Nested contexts share one list: a signal from before a run ends that run at its first instant.
    A further signal, more than two seconds after the first, raises KeyboardInterrupt immediately:
    the user is then waiting for a component that hangs.
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
    """Ignore these signals in a short block, so that the stop of devices completes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
