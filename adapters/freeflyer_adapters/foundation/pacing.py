"""Real-time scheduling of the process, and waiting for absolute deadlines."""

from __future__ import annotations

import ctypes
import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from freeflyer_adapters.foundation import environment
from freeflyer_adapters.foundation.histogram import Histogram

PR_SET_TIMERSLACK = 29
MCL_CURRENT, MCL_FUTURE = 1, 2
LINK_PRIORITY, LOOP_PRIORITY = 20, 40
"""SCHED_FIFO priorities of the threads of the links and of the loop."""


def prepare_links(real_time: bool) -> None:
    """Set the priority LINK_PRIORITY for the threads of the links, if the system permits it.

    The function sets the priority of the calling thread. A new thread inherits the priority of the
    thread that creates it. So this function must be called before devices open their links.
    """
    if real_time:
        with suppress(OSError, AttributeError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(LINK_PRIORITY))


def enter_real_time(real_time: bool) -> list[str]:
    """Request SCHED_FIFO, locked memory and a short timer slack.

    Returns one phrase about the result of each request.
    """
    return [_scheduler(real_time), _memory(real_time), _timer_slack()]


def leave_real_time() -> None:
    """Restore ordinary scheduling. Unlock the memory, because locked memory slows allocations."""
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).munlockall()


def _scheduler(real_time: bool) -> str:
    if not real_time:
        return "ordinary scheduling (as requested)"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(LOOP_PRIORITY))
    except (OSError, AttributeError) as error:
        return f"ordinary scheduling (SCHED_FIFO refused: {getattr(error, 'strerror', error)})"
    return f"SCHED_FIFO {LOOP_PRIORITY}"


def _memory(real_time: bool) -> str:
    if not real_time:
        return "memory not locked (as requested)"
    try:
        failed = ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT | MCL_FUTURE)
    except (OSError, AttributeError):
        failed = -1
    return f"memory not locked ({os.strerror(ctypes.get_errno())})" if failed else "memory locked"


def _timer_slack() -> str:
    try:
        failed = ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)
    except (OSError, AttributeError):
        failed = -1
    return "timer slack unchanged" if failed else "timer slack 1 ns"


@contextmanager
def no_collection() -> Iterator[None]:
    """Disable the garbage collection of Python while the loop runs."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


class Pacer:
    """Timer that waits for the deadlines t0 + k * period (k = 1, 2, ...). `period` is in [ns].

    t0 is the time of the first call of `wait`. If `wait` returns more than one period after its
    deadline, t0 is reset to the present time and k to 0. So missed deadlines are skipped, and
    `wait` does not return several times in quick succession. `overruns` counts these resets.
    """

    def __init__(self, period: int) -> None:
        self.period = period
        self.overruns = 0
        self.lateness = Histogram()
        self.late = 0
        """Delay of the last wake-up relative to its deadline [ns]."""
        self._deadline = 0
        self._environment = environment.present()

    def wait(self) -> int:
        """Wait for the next deadline. Return the time of wake-up [ns of CLOCK_MONOTONIC]."""
        now = self._environment.monotonic_ns()
        if not self._deadline:
            self._deadline = now
        self._deadline += self.period
        if now < self._deadline:
            self._environment.sleep((self._deadline - now) * 1e-9)
            now = self._environment.monotonic_ns()
        self.late = now - self._deadline
        self.lateness.add(self.late)
        if self.late > self.period:
            self.overruns += 1
            self._deadline = now
        return now
