"""Virtual facility that runs in virtual time, in the process of the host.

The host is the program that runs the control loop.
"""

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


def _discard(text: str) -> None:
    pass


@contextmanager
def accelerated(
    scenario: Scenario, fmi: int | None = None, log: Callable[[str], None] = _discard
) -> Iterator[Accelerated]:
    """Run a facility in virtual time within the context.

    Within the context, call `freeflyer_adapters.loop.hil.run` with `real_time=False`. It runs the
    control loop, which connects to the facility and uses the virtual time. `fmi`, if given,
    overrides the FMI version of the models. `log` receives one line per event of the facility.
    Raises CosimError if the facility cannot be created.
    """
    time = VirtualTime()
    with (
        environment.within(time),
        closing(Facility(scenario, fmi)) as facility,
        closing(facility.cycles(log)) as cycles,
    ):
        time.play(cycles, facility.period)
        yield Accelerated(facility=facility, time=time)
