"""The multi-rate schedule. The smallest step is the tick. All steps are multiples of the tick.

`freeflyer.master.graph` orders the components that step at the same instant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from freeflyer.foundation.clock import shown
from freeflyer.foundation.errors import GraphError


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Times of a run [ns].

    Instant k is at the time k * tick. At instant k, every component with k % ratio == 0 starts a
    step.
    """

    tick: int
    ratios: Mapping[str, int]
    stop: int
    record_ratio: int

    @property
    def ticks(self) -> int:
        return self.stop // self.tick

    def size(self, component: str, k: int) -> int:
        """Return the length [ns] of the step of `component` that starts at instant k.

        A step that would end after the stop time is shortened.
        """
        return min(self.ratios[component] * self.tick, self.stop - k * self.tick)


def build(
    steps: Mapping[str, int], stop: int, record_every: int, variable_step: Mapping[str, bool]
) -> Schedule:
    """Build the schedule from steps, stop time and recording interval [ns].

    Raises GraphError if a time is not a multiple of the smallest step. Raises GraphError also if a
    step does not divide the stop time and the component cannot shorten its last step. The message
    contains times that would fit.
    """
    tick = min(steps.values())
    for name, step in steps.items():
        _multiple(step, tick, f"component {name}: its step", "the smallest step")
        if stop % step and not variable_step[name]:
            raise GraphError(
                f"component {name} cannot shorten its last step, and its step of {shown(step)} does not divide the stop time "
                f"{shown(stop)}; a stop time of {shown(stop - stop % step)} would fit"
            )
    _multiple(stop, tick, "the stop time", "the smallest step")
    _multiple(record_every, tick, "the recording interval", "the smallest step")
    return Schedule(
        tick=tick,
        ratios={name: step // tick for name, step in steps.items()},
        stop=stop,
        record_ratio=record_every // tick,
    )


def _multiple(value: int, of: int, subject: str, what: str) -> None:
    if value % of:
        below, above = value - value % of, value - value % of + of
        fits = f"{shown(below)} or {shown(above)}" if below else shown(above)
        raise GraphError(
            f"{subject} of {shown(value)} is not a multiple of {what}, {shown(of)}; {fits} would fit"
        )
