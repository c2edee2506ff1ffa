"""What the virtual facility asks of a device's end of a link."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Generic, Protocol, TypeVar

from adapters.histogram import Histogram
from cosim.component import Array, Port


class Logic(Protocol):
    """What the device's own controller decides, as far as a session needs it."""

    events: list[tuple[int, str]]
    """Cycle and what happened."""
    was_active: bool

    @property
    def session_is_over(self) -> bool: ...


L = TypeVar("L", bound=Logic)


class VirtualDevice(ABC, Generic[L]):
    """`receive` at the begin of a cycle, then the model's step, then `send`; `begin_session` before the first."""

    name: str
    logic: L
    commands: tuple[Port, ...]
    """What comes over the wire for the model's inputs."""
    measurements: tuple[Port, ...]
    """What goes over the wire of the model's outputs."""

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
