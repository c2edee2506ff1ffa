"""The master: steps the components of a graph on a multi-rate schedule, and records.

At an instant t:
1. delayed connections keep what their sources had before t;
2. components whose last step ends at t hand over their outputs of t;
3. controllers due at t sample and answer, in the graph's order, each output used at once;
4. the instant is recorded, and the limits are checked;
5. all other components due at t take their inputs, and then step on.

`Master.run` does this in Python, call by call; cosim/freeflyer/master/core does the same in C, and cosim/freeflyer/master/native.py hands a master to it.
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
from freeflyer.master import limits as watched
from freeflyer.master.graph import Graph
from freeflyer.master.limits import Limit, Watch
from freeflyer.master.record import Record
from freeflyer.master.schedule import Schedule
from freeflyer.master.slaves import Slave, Slaves


@dataclass(kw_only=True)
class Outcome:
    """How a run ended. `cause` says why it stopped before its time: it `diverged` (a limit, or an FMU whose equations' own limits
    were passed), it `failed` (anything else that went wrong), or it was `interrupted`.
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
    """Ties a run's instants to the outside: called at every instant k, before anything happens and after all has.

    `before` returns a reason to end the run before this instant, or None.
    """

    def before(self, k: int) -> str | None: ...

    def after(self, k: int) -> None: ...


class Master:
    """Binds a graph to its buffers; a master runs once. `recorded` chooses among the signals COMPONENT.VARIABLE."""

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
        """Components with plant-like outputs first, so that the others are initialised with real inputs.

        An input whose source is not initialised yet keeps its own start value. Raises CosimError.
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
        """The present value of an output, COMPONENT.VARIABLE: a view."""
        return self.slaves.value(signal)

    def hand_over(self, name: str) -> None:
        """Give a component its inputs at the end of an instant, delayed ones too: for a hook that sends commands there."""
        self.slaves[name].take_present_inputs()
        self.slaves[name].write()

    def run(self, progress: Progress | None = None, hooks: Sequence[InstantHook] = ()) -> Outcome:
        outcome = self.outcome()
        begin = time.perf_counter()
        with interrupts() as interrupted:
            for _ in self.instants(outcome, interrupted, progress, hooks):
                pass
        outcome.wall = time.perf_counter() - begin
        return outcome

    def instants(
        self,
        outcome: Outcome,
        interrupted: Sequence[float] = (),
        progress: Progress | None = None,
        hooks: Sequence[InstantHook] = (),
    ) -> Iterator[None]:
        """One instant after another, for who has other things to do between them; `outcome` is whole once there are no more.

        The run ends where `interrupted` is no longer empty.
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
                self.refuse_at_start(k, error)
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

    def refuse_at_start(self, k: int, error: StepFailed) -> None:
        """What fails before anything has moved is no result. Raises ComponentError."""
        if k == 0 and not error.left_validity:
            raise ComponentError(f"component {error}") from error

    def finish(self, outcome: Outcome, k: int, *, whole: bool) -> None:
        """The run has ended at tick k, which is recorded too; but not an instant that a failed step has left incomplete."""
        outcome.simulated = seconds(k * self.schedule.tick)
        record = self.record
        if record.rows == 0 or (whole and record.time[-1] < outcome.simulated):
            record.append(outcome.simulated, self.slaves.now[self.columns])

    def _instant(self, k: int, outcome: Outcome, *, last: bool) -> str | None:
        """Everything that happens at tick k; at the last one nobody steps on. A cause if a limit is passed."""
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
        except Exception as error:  # a component written by others fails in its own ways; the run is kept all the same
            raise failure(name, error) from error
        outcome.steps[name] += 1


def failure(name: str, error: Exception) -> StepFailed:
    return StepFailed(
        name, message_of(error), left_validity=bool(getattr(error, "left_validity", False))
    )


def message_of(error: Exception) -> str:
    """One sentence for an exception of somebody else's component: its own if it knows of us, else with kind and place."""
    if hasattr(error, "left_validity"):
        return " ".join(str(error).split())
    place = traceback.extract_tb(error.__traceback__)[-1]
    return " ".join(
        f"{type(error).__name__}: {error} ({place.filename}, line {place.lineno}){renamed(error)}".split()
    )
