"""The master. It steps the components of a graph, each with its own step, and records the outputs.

An instant is a point in time at which steps may start. A component is due at an instant if its next
step starts at this instant. A controller computes its outputs for the start of a step. A plant
computes its outputs for the end of a step. Here, each component that is not a controller is called
a plant. A delayed connection transfers the value that its source had before the instant.

At an instant t, the master does the following:
1. It stores the present values of the sources of delayed connections. No output has been computed
   for t yet. Therefore these are the values from before t.
2. It reads the outputs of the plants whose last step ends at t.
3. It steps the controllers that are due at t one after the other, in the order that the graph
   contains. Each controller uses the outputs that earlier controllers have computed at t.
4. It records the outputs if t is a recording instant. Then it checks the limits.
5. It writes the inputs of all plants that are due at t. Then it steps these plants.
At the stop time and after an interruption, no step begins: only 1, 2 and 4 are done. In this last
row of the record, plants have their values at t, and controllers the values of their last samples.

`Master.run` executes these operations in Python. The C code in cosim/freeflyer/master/core executes
the same operations. cosim/freeflyer/master/native.py runs a master with this C code.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from freeflyer.fmi.component import Array
from freeflyer.foundation.clock import seconds
from freeflyer.foundation.errors import ComponentError, CosimError, StepFailed, one_line
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
    """The result of a run.

    `simulated`: simulated time [s].
    `wall`: wall-clock time [s].
    `steps`: number of steps of each component.
    `diverged`: a limit was exceeded, or the equations of an FMU left their range of validity.
    `failed`: any other error occurred.
    `interrupted`: the user stopped the run.
    `cause`: the reason why the run stopped early, or None.
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
    """Hook that is called at every instant of a run. `k` is the number of the instant.

    `before` is called before the first operation of the instant. The result of `before` is None, or
    the reason why the run must end before this instant. `after` is called after the last operation
    of the instant, unless the run ends early at this instant.
    """

    def before(self, k: int) -> str | None: ...

    def after(self, k: int) -> None: ...


class Master:
    """A graph with buffers for the values of its components. A master can run only once.

    `limits` contains the limits that end the run when they are exceeded. The function `recorded` is
    called with the name COMPONENT.VARIABLE of each output. If the function returns True, the output
    is recorded. `rows` is a new file for the rows of the record (`Record`), or None.
    """

    def __init__(
        self,
        graph: Graph,
        schedule: Schedule,
        limits: Sequence[Limit] = (),
        recorded: Callable[[str], bool] = lambda signal: True,
        rows: Path | None = None,
    ) -> None:
        for limit in limits:
            watched.check(limit, graph.components)
        self.graph, self.schedule = graph, schedule
        self.slaves = Slaves(graph, schedule.ratios, [limit.signal for limit in limits])
        self.watches = [
            Watch(limit, self.slaves.value(limit.signal), schedule.tick) for limit in limits
        ]
        signals, self.columns = self.slaves.signals(graph, recorded)
        self.record = Record(signals, schedule.ticks // schedule.record_ratio + 2, rows)
        self.sampled_at_end = False

    def initialise(self, start_values: Mapping[str, Mapping[str, Array]]) -> None:
        """Initialise all components.

        `start_values` contains values [SI] by the name of the component and of the variable.

        The controllers are initialised after the plants. Therefore a controller receives the
        initial outputs of all plants. If the source of an input is initialised later than the
        component of the input, the input keeps its own start value during the initialisation.
        Raises CosimError if a component cannot be initialised.
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
            except Exception as error:
                if isinstance(error, CosimError) and not isinstance(error, StepFailed):
                    raise
                raise ComponentError(
                    f"component {name} cannot be initialised: {message_of(error)}"
                ) from error
            ready.add(name)

    def value(self, signal: str) -> Array:
        """Return a view of the present value of the output COMPONENT.VARIABLE."""
        return self.slaves.value(signal)

    def write_inputs_now(self, name: str) -> None:
        """Write the present values of the sources to the inputs of the component `name`.

        Delayed connections transfer the present value, too. In a run with devices, a hook calls
        this method at the end of an instant, before the device sends its inputs as commands.
        """
        self.slaves[name].take_present_inputs()
        self.slaves[name].write()

    def run(self, progress: Progress | None = None, hooks: Sequence[InstantHook] = ()) -> Outcome:
        """Run to the stop time, or until the run ends early.

        `progress` is called now and then with the simulated time [s]. Raises ComponentError if a
        component fails at instant 0 and there are no hooks.
        """
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
        """Run, and yield after every instant, except after an instant that ends the run early.

        Pass the result of the method `outcome` as the argument `outcome`. This object is complete
        when the iterator ends. `interrupted` is the list of the context `interrupts`. The run ends
        at the first instant at which this list is not empty.
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
        """Raise ComponentError if the failure `error` occurred at instant 0.

        No result exists yet at this instant. If k, the instant of the failure, is not 0, the method
        does nothing. If the equations left their range of validity, the run counts as diverged, and
        the method does nothing.
        """
        if k == 0 and not error.left_validity:
            raise ComponentError(f"component {error}") from error

    def finish(self, outcome: Outcome, k: int, *, whole: bool) -> None:
        """End the run at instant k.

        `whole` is False if a failed step has left the outputs at instant k incomplete. If `whole`
        is True and instant k is not recorded yet, this method records instant k. If the record is
        empty, this method always records instant k. `sampled_at_end` becomes True if the last row
        has the controllers' samples of its time (`Provenance.sampled_at_end`).
        """
        stopped = outcome.diverged or outcome.failed
        self.sampled_at_end = stopped and not outcome.interrupted and k < self.schedule.ticks
        outcome.simulated = seconds(k * self.schedule.tick)
        record = self.record
        if record.rows == 0 or (whole and record.time[-1] < outcome.simulated):
            record.append(outcome.simulated, self.slaves.now[self.columns])

    def _instant(self, k: int, outcome: Outcome, *, last: bool) -> str | None:
        """Execute the operations of instant k.

        If a limit is exceeded, return the message, otherwise None. If `last` is True, the run ends
        at this instant, and no component steps.
        """
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
        except Exception as error:  # third-party code may raise any type; keep the record
            raise StepFailed(name, message_of(error)) from error
        outcome.steps[name] += 1


def message_of(error: Exception) -> str:
    """Return the message of an exception that a component has raised.

    StepFailed has a message for the user. For any other exception, the result also contains the
    type of the exception and its place in the source code.
    """
    if isinstance(error, StepFailed):
        return str(error)
    place = traceback.extract_tb(error.__traceback__)[-1]
    return one_line(
        f"{type(error).__name__}: {error} ({place.filename}, line {place.lineno}){renamed(error)}"
    )
