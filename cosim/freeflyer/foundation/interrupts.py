"""Deferred handling of Ctrl-C and of signals that end a process, such as SIGTERM.

A run consists of instants, at which the master steps components. Between two instants, the master
checks whether such a signal has arrived.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals after which a run ends in an orderly way, between two instants.

`interrupts` does not collect a signal that the process already ignores, for example after nohup.
"""
_noted: list[list[float]] = []
"""Contains one item while an `interrupts` context is active, otherwise no items.

The item is the list of arrival times that the outermost context returned.
"""
_raised: list[float] = []
"""Arrival times [s] of the signals that `end_at_signals` has converted to an exception."""


class _Interrupted(KeyboardInterrupt):
    """A signal has arrived.

    If a plain KeyboardInterrupt leaves code that is compiled by `exec`, for example in the import
    of a dataclass, CPython ends the process by SIGINT, although the exception is caught.
    """


def end_at_signals() -> None:
    """Let the signals in `ENDING` end a command by KeyboardInterrupt, except ignored signals.

    Libraries may discard this exception, for example pyarrow while it imports pandas, and Python
    in `__del__`. Then the next `interrupts` context contains the signal.
    """

    def end(number: int, frame: object) -> None:
        _raised.append(time.monotonic())
        raise _Interrupted

    def unraisable(found: sys.UnraisableHookArgs) -> None:
        if not isinstance(found.exc_value, _Interrupted):
            sys.__unraisablehook__(found)

    sys.unraisablehook = unraisable
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, end)


@contextmanager
def interrupts() -> Iterator[list[float]]:
    """Collect the signals in `ENDING`. The context returns a list of their arrival times [s].

    The master ends a run between two instants if this list is not empty. Nested contexts share one
    list. For example, a command opens the outer context, and its run opens the inner context. If a
    signal arrives before the run starts, the run ends at its first instant.

    A signal that arrives more than two seconds after the first signal raises KeyboardInterrupt
    immediately. In this case the run has not ended yet, probably because a component does not
    respond.

    In a thread other than the main thread, no signals are collected and the list stays empty.
    """
    if _noted:
        yield _noted[0]
        return
    if threading.current_thread() is not threading.main_thread():
        yield []
        return
    seen = list(_raised)

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

    The code that stops devices runs in such a block, so that no signal can interrupt this code. In
    a thread other than the main thread, this context has no effect.
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
