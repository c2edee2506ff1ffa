"""What devices reach the outside by: clocks, CAN buses, Zenoh sessions. Virtual time puts its own in their place.

Whoever needs one asks `present()` when it is made and keeps it, so that every part of a loop, and both ends of a facility's links,
can be run in virtual time (`freeflyer_adapters.facility.virtual_time`) without a line of their own for it.
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
    """The real one."""

    # Asked for some twenty times in a cycle of 1 ms: the system's own functions, without a call of ours around them.
    monotonic_ns: Callable[[], int] = staticmethod(time.monotonic_ns)
    """[ns], from an unknown beginning; it never goes back."""
    time_ns: Callable[[], int] = staticmethod(time.time_ns)
    """[ns since the epoch], as the system's clock has it; it may be set."""

    def monotonic(self) -> float:
        """[s]"""
        return self.monotonic_ns() * 1e-9

    def sleep(self, duration: float) -> None:
        """[s]"""
        time.sleep(duration)

    def bus(self, **arguments: Any) -> can.BusABC:
        """As python-can opens it, with its errors."""
        return can.Bus(**arguments)

    def session(self, config: zenoh.Config) -> Any:
        """As Zenoh opens it, with its errors."""
        return zenoh.open(config)


_present: ContextVar[Environment] = ContextVar("environment", default=Environment())  # noqa: B039 - it has no state


def present() -> Environment:
    return _present.get()


@contextmanager
def within(other: Environment) -> Iterator[None]:
    """What is made meanwhile reaches the outside by `other`."""
    token = _present.set(other)
    try:
        yield
    finally:
        _present.reset(token)
