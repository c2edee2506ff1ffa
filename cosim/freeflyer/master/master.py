"""The master: steps the components of a graph on a multi-rate schedule, and records their outputs.

At an instant t:
1. delayed connections store the outputs of their sources from before t;
2. the outputs at t of components whose last step ends at t are read;
3. controllers due at t sample and compute one after the other, in the graph's order; the next one
   uses the outputs of the same instant;
4. the instant is recorded, and the limits are checked;
5. all other components due at t take their inputs and then step.

`Master.run` is the Python implementation and calls every component itself. The C implementation is
in cosim/freeflyer/master/core; cosim/freeflyer/master/native.py runs a master with it.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from freeflyer.fmi.component import Array
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import ComponentError, CosimError, StepFailed
from freeflyer.foundation.interrupts import interrupts
from freeflyer.foundation.plugins import renamed
from freeflyer.master import divergence as watched
from freeflyer.master.divergence import Limit, Watch
from freeflyer.master.graph import Graph
from freeflyer.master.record import Record
from freeflyer.master.schedule import Schedule
from freeflyer.master.slaves import Slave, Slaves


@dataclass(kw_only=True)
class Outcome:
    """The result of a run, and why it stopped early, in `cause`.

    `diverged`: a limit was exceeded, or an FMU's equations left their range of validity. `failed`:
    any other error. `interrupted`: the user stopped the run.
    """

    record: Record
    simulated: float
    wall: float
    steps: dict[str, int]
    diverged: bool = False
    failed: bool = False
    cause: str | None = None
    interrupted: bool = False

    def stopped_by(self, error: StepFailed) -> None:
        self.diverged, self.failed, self.cause = (
            error.left_validity,
            not error.left_validity,
            str(error),
        )


Progress = Callable[[float], None]


class InstantHook(Protocol):
    """Hook of a run, called at every instant k: `before` its first and `after` its last operation.

    `before` returns a reason to end the run before this instant, or None.
    """

    def before(self, k: int) -> str | None: ...

    def after(self, k: int) -> None: ...


class Master:
    """A graph bound to its buffers. A master runs once.

    `recorded` selects the recorded signals by their names COMPONENT.VARIABLE.
    """

    def __init__(
        self,
        graph: Graph,
        schedule: Schedule,
        limits: Sequence[Limit] = (),
        recorded: Callable[[str], bool] = lambda signal: True,
    ) -> None:
        for limit in limits:
            watched.check(limit, graph.components)
        self.graph, self.schedule = graph, schedule
        self.slaves = Slaves(graph, schedule.ratios, [limit.signal for limit in limits])
        self.watches = [
            Watch(limit, self.slaves.value(limit.signal), schedule.tick) for limit in limits
        ]
        signals, self.columns = self.slaves.signals(graph, recorded)
        self.record = Record(signals, schedule.ticks // schedule.record_ratio + 2)

    def initialise(self, start_values: Mapping[str, Mapping[str, Array]]) -> None:
        """Initialise all components with their start values. Raises CosimError.

        Components whose outputs belong to the end of a step are first, so that the others get their
        outputs. An input whose source is not initialised yet keeps its own start value.
        """
        ready: set[str] = set()
        for name in (*self.graph.then, *self.graph.first):
            slave = self.slaves[name]
            try:
                slave.component.enter_initialization(0.0, start_values.get(name, {}))
                slave.take_first_inputs(ready)
                slave.write()
                slave.component.exit_initialization()
                slave.read()
            except CosimError:
                raise
            except Exception as error:
                raise ComponentError(
                    f"component {name} cannot be initialised: {message_of(error)}"
                ) from error
            ready.add(name)

    def value(self, signal: str) -> Array:
        """Return a view of the present value of the output COMPONENT.VARIABLE."""
        return self.slaves.value(signal)

    def write_inputs_now(self, name: str) -> None:
        """Write a component's inputs at the end of an instant, for a hook that sends commands then.

        Delayed connections deliver their present values here, too.
        """
        self.slaves[name].take_present_inputs()
        self.slaves[name].write()

    def run(self, progress: Progress | None = None, hooks: Sequence[InstantHook] = ()) -> Outcome:
        """Run to the stop time or until the run stops early. Raises ComponentError at instant 0."""
        outcome = self.outcome()
        start = time.perf_counter()
        with interrupts() as interrupted:
            for _ in self.instants(outcome, interrupted, progress, hooks):
                pass
        outcome.wall = time.perf_counter() - start
        return outcome

    def instants(
        self,
        outcome: Outcome,
        interrupted: Sequence[float] = (),
        progress: Progress | None = None,
        hooks: Sequence[InstantHook] = (),
    ) -> Iterator[None]:
        """Yield after every instant. `outcome` is complete when the iterator ends.

        The run ends at the first instant at which `interrupted` is not empty.
        """
        schedule = self.schedule
        before, after = [hook.before for hook in hooks], [hook.after for hook in hooks]
        k, whole = 0, True
        try:
            for k in range(schedule.ticks + 1):
                for call in before:
                    outcome.cause = outcome.cause or call(k)
                if outcome.cause:
                    break
                outcome.interrupted = bool(interrupted) and k < schedule.ticks
                cause = self._instant(k, outcome, last=outcome.interrupted or k == schedule.ticks)
                if cause:
                    outcome.diverged, outcome.cause = True, cause
                    break
                if outcome.interrupted:
                    outcome.cause = "interrupted by the user"
                    break
                if progress and k % 1000 == 0:
                    progress(seconds(k * schedule.tick))
                for done in after:
                    done(k)
                yield
        except StepFailed as error:
            if not hooks:
                self.reject_failure_at_start(k, error)
            outcome.stopped_by(error)
            whole = False
        self.finish(outcome, k, whole=whole)

    def outcome(self) -> Outcome:
        return Outcome(
            record=self.record,
            simulated=0.0,
            wall=0.0,
            steps=dict.fromkeys(self.graph.components, 0),
        )

    def reject_failure_at_start(self, k: int, error: StepFailed) -> None:
        """Raise ComponentError if a component failed at instant 0, where there is no result yet."""
        if k == 0 and not error.left_validity:
            raise ComponentError(f"component {error}") from error

    def finish(self, outcome: Outcome, k: int, *, whole: bool) -> None:
        """End the run at tick k and record it, unless a failed step left the instant incomplete."""
        outcome.simulated = seconds(k * self.schedule.tick)
        record = self.record
        if record.rows == 0 or (whole and record.time[-1] < outcome.simulated):
            record.append(outcome.simulated, self.slaves.now[self.columns])

    def _instant(self, k: int, outcome: Outcome, *, last: bool) -> str | None:
        """Execute tick k, without steps at the last one. Return a cause if a limit is exceeded."""
        schedule, graph, slaves = self.schedule, self.graph, self.slaves
        moment = seconds(k * schedule.tick)
        slaves.keep_delayed()
        if k:
            for name in graph.then:
                if k % slaves[name].ratio == 0 or k == schedule.ticks:
                    slaves[name].read()
        if not last:
            for name in graph.first:
                slave = slaves[name]
                if k % slave.ratio == 0:
                    slave.take_inputs()
                    slave.write()
                    self._step(slave, k, outcome)
                    slave.read()
        if k % schedule.record_ratio == 0:
            self.record.append(moment, slaves.now[self.columns])
        for watch in self.watches:
            cause = watch()
            if cause:
                return cause
        if last:
            return None
        due = [slaves[name] for name in graph.then if k % slaves[name].ratio == 0]
        for slave in due:
            slave.take_inputs()
            slave.write()
        for slave in due:
            self._step(slave, k, outcome)
        return None

    def _step(self, slave: Slave, k: int, outcome: Outcome) -> None:
        name = slave.component.name
        try:
            slave.component.step(
                seconds(k * self.schedule.tick), seconds(self.schedule.size(name, k))
            )
        except StepFailed:
            raise
        except Exception as error:  # third-party components raise any type; the record is kept
            raise failure(name, error) from error
        outcome.steps[name] += 1


def failure(name: str, error: Exception) -> StepFailed:
    """Convert an exception of a component to StepFailed."""
    return StepFailed(
        name, message_of(error), left_validity=bool(getattr(error, "left_validity", False))
    )


def message_of(error: Exception) -> str:
    """Format a component's exception; one that is not ours with its type and location."""
    if hasattr(error, "left_validity"):
        return " ".join(str(error).split())
    place = traceback.extract_tb(error.__traceback__)[-1]
    return " ".join(
        f"{type(error).__name__}: {error} ({place.filename}, line {place.lineno}){renamed(error)}".split()
    )
