"""The environment of devices: clocks, CAN buses and Zenoh sessions.

An object that needs the environment calls `present()` in its constructor and keeps the result. A
run in virtual time uses another environment (`freeflyer_adapters.facility.virtual_time`). The loop,
the facility and the links between them have the same code in both environments.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import can
import zenoh


class Environment:
    """The real environment."""

    # `monotonic_ns` is called about twenty times per cycle of 1 ms. The attribute is the function
    # of `time` itself, because a method that calls this function would take more time.
    monotonic_ns: Callable[[], int] = staticmethod(time.monotonic_ns)
    """Monotonic clock with an arbitrary zero [ns]."""
    time_ns: Callable[[], int] = staticmethod(time.time_ns)
    """Wall clock [ns since the epoch]. This clock may be set forward or back during a run."""

    def monotonic(self) -> float:
        """Return the monotonic clock [s]."""
        return self.monotonic_ns() * 1e-9

    def sleep(self, duration: float) -> None:
        """Sleep for `duration` [s]."""
        time.sleep(duration)

    def bus(self, **arguments: Any) -> can.BusABC:
        """Open a bus of python-can. Raises the exceptions of python-can."""
        return can.Bus(**arguments)

    def session(self, config: zenoh.Config) -> Any:
        """Open a Zenoh session. Raises zenoh.ZError if this fails."""
        return zenoh.open(config)


_present: ContextVar[Environment] = ContextVar("environment", default=Environment())  # noqa: B039 - it has no state


def present() -> Environment:
    """Return the environment of the current context."""
    return _present.get()


@contextmanager
def within(other: Environment) -> Iterator[None]:
    """Make `other` the environment of all objects that are constructed in the block."""
    token = _present.set(other)
    try:
        yield
    finally:
        _present.reset(token)
