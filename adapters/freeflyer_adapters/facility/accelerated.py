"""A virtual facility in the host's own process and in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

from freeflyer.scenario.scenario import Scenario
from freeflyer_adapters.facility.server import Facility
from freeflyer_adapters.facility.virtual_time import VirtualTime
from freeflyer_adapters.foundation import environment


@dataclass(frozen=True, kw_only=True)
class Accelerated:
    facility: Facility
    time: VirtualTime


def _unheard(text: str) -> None:
    pass


@contextmanager
def accelerated(
    scenario: Scenario, fmi: int | None = None, say: Callable[[str], None] = _unheard
) -> Iterator[Accelerated]:
    """What is run meanwhile (`freeflyer_adapters.loop.hil.run` without real time) meets this facility, and its time. Raises CosimError."""
    time = VirtualTime()
    with (
        environment.within(time),
        closing(Facility(scenario, fmi)) as facility,
        closing(facility.cycles(say)) as cycles,
    ):
        time.play(cycles, facility.period)
        yield Accelerated(facility=facility, time=time)
