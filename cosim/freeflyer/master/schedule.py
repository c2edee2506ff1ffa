"""The multi-rate schedule: every component's step is a multiple of the smallest step, the tick."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from freeflyer.foundation.clock import shown
from freeflyer.foundation.errors import GraphError


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Times in ns. At tick k, time k * tick, every component with k % ratio == 0 makes a step."""

    tick: int
    ratios: Mapping[str, int]
    stop: int
    record_ratio: int

    @property
    def ticks(self) -> int:
        return self.stop // self.tick

    def size(self, component: str, k: int) -> int:
        """Return the step [ns] of `component` from tick k, shortened at the stop time."""
        return min(self.ratios[component] * self.tick, self.stop - k * self.tick)


def build(
    steps: Mapping[str, int], stop: int, record_every: int, variable_step: Mapping[str, bool]
) -> Schedule:
    """Build the schedule from steps, stop time and recording interval [ns].

    Raises GraphError, with times that would fit, if one is no multiple of the smallest step.
    """
    tick = min(steps.values())
    for name, step in steps.items():
        _multiple(step, tick, f"component {name}: its step", "the smallest step")
        if stop % step and not variable_step[name]:
            raise GraphError(
                f"component {name} cannot shorten its last step, and its step of {shown(step)} does not divide the stop time "
                f"{shown(stop)}; {shown(stop - stop % step)} would fit"
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
            f"{subject} of {shown(value)} is no multiple of {what}, {shown(of)}; {fits} would fit"
        )
