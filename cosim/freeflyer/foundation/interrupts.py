"""Deferred handling of Ctrl-C and SIGTERM.

The master checks between two instants whether one of these signals has arrived.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals after which a run ends in an orderly way, between two instants.

If the process already ignores a signal (nohup), `interrupts` leaves this signal ignored.
"""
_noted: list[list[float]] = []
"""Contains the list of the outermost `interrupts` context. Empty if no context is active."""


@contextmanager
def interrupts() -> Iterator[list[float]]:
    """Collect the arrival times [s] of the signals in `ENDING` in a list.

    If this list is not empty, a run ends between two instants. Nested contexts share one list. If a
    signal arrives in the outer context before a run, this run therefore ends at its first instant.

    A further signal raises KeyboardInterrupt immediately if it arrives more than two seconds after
    the first signal. In this case the user is waiting for a component that does not respond.
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
    """Ignore the signals in `ENDING` during a short block.

    Devices are stopped in such a block. Therefore a signal cannot prevent the stop of a device.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
