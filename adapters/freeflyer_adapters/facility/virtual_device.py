"""What the virtual facility asks of a device's end of a link."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from freeflyer.fmi.component import Array, Port
from freeflyer_adapters.facility.link_faults import LinkFaults
from freeflyer_adapters.foundation.histogram import Histogram


class Logic(Protocol):
    """What the device's own controller decides, as far as a session needs it."""

    events: list[tuple[int, str]]
    """Cycle and what happened."""
    was_active: bool

    @property
    def session_is_over(self) -> bool: ...


class LinkEnd(Protocol):
    silent: bool
    """The device neither sends nor receives."""


L = TypeVar("L", bound=Logic)


class VirtualDevice(ABC, Generic[L]):
    """`receive` at the begin of a cycle, then the model's step, then `send`; `begin_session` before the first."""

    name: str
    fault_kinds: ClassVar[tuple[str, ...]] = ()
    """Those of `freeflyer_adapters.facility.faults.KINDS` that it can play."""
    logic: L
    commands: tuple[Port, ...]
    """What comes over the wire for the model's inputs."""
    measurements: tuple[Port, ...]
    """What goes over the wire of the model's outputs."""

    # Faults of the whole device

    def begin_faults(self, faults: LinkFaults[Any], end: LinkEnd) -> None:
        """With a session: none acts yet, and `end`, the device's end of the link, is open."""
        self._faults, self._end = faults, end
        self._cycles = 0
        self._active_since: int | None = None
        faults.reset()
        end.silent = False

    def begin_cycle(self) -> bool:
        """First in a cycle; whether the device's own controller works in it."""
        faults = self._faults
        self._cycles += 1
        if self._active_since is None and self.logic.was_active:
            self._active_since = self._cycles
        faults.begin_cycle(
            None if self._active_since is None else self._cycles - self._active_since
        )
        dead, hung = faults.acts("dead"), faults.acts("hung")
        if dead:
            self.power_off()
        elif faults.acts("device_fault"):
            self.fail()
        self._end.silent = dead or hung
        return not hung

    def power_off(self) -> None:
        """What remains of a device without power: its brakes."""

    def fail(self) -> None:
        """The device finds a fault in itself."""

    @abstractmethod
    def begin_session(self, parameters: Mapping[str, Array]) -> None:
        """The robots are back at their start poses; `parameters` are the model's."""

    @abstractmethod
    def receive(self, values: Mapping[str, Array]) -> None:
        """Fill `commands` with what acts until the next cycle."""

    @abstractmethod
    def send(self, values: Mapping[str, Array]) -> None:
        """Send `measurements`."""

    @abstractmethod
    def report(self) -> Mapping[str, float]:
        """Counters by name."""

    def histograms(self) -> Mapping[str, Histogram]:
        """Times by name."""
        return {}

    @abstractmethod
    def close(self) -> None: ...

    @property
    def events(self) -> list[tuple[int, str]]:
        return self.logic.events

    @property
    def session_is_over(self) -> bool:
        return self.logic.session_is_over

    @property
    def is_idle(self) -> bool:
        """Whether the device has not been active in this session."""
        return not self.logic.was_active
