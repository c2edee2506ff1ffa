"""The multi-rate schedule: the times at which each component starts its steps.

Each component has its own communication step. The smallest of these steps is called the tick. All
steps are multiples of the tick. Instant k is the time k * tick.

The schedule does not order the components that step at the same instant. `execution_order`
determines their order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from freeflyer.foundation.clock import shown
from freeflyer.foundation.errors import GraphError


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """The times of a run.

    `tick`: the smallest step [ns].
    `ratios`: for each component, the length of its step in ticks. At instant k, each component with
    k % ratio == 0 starts a step.
    `stop`: the stop time [ns].
    `record_ratio`: the length of the recording interval in ticks.
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
    """Build a schedule.

    `steps` contains the step of each component, `stop` is the stop time, and `record_every` is the
    recording interval [ns]. `variable_step` contains for each component whether its last step may
    be shorter than its other steps.

    Raises GraphError if a time is not a multiple of the smallest step. Raises GraphError also if
    the stop time is not a multiple of a component's step and the component cannot shorten its last
    step. The message contains times that would fit.
    """
    tick = min(steps.values())
    for name, step in steps.items():
        _multiple(step, tick, f"component {name}: its step", "the smallest step")
        if stop % step and not variable_step[name]:
            raise GraphError(
                f"component {name} cannot shorten its last step, and the stop time of {shown(stop)} is not a multiple of "
                f"its step of {shown(step)}; a stop time of {shown(stop - stop % step)} would fit"
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
