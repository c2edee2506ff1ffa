"""The master: steps the components of a graph on a multi-rate schedule, and records.

At an instant t:
1. delayed connections keep what their sources had before t;
2. components whose last step ends at t hand over their outputs of t;
3. controllers due at t sample and answer, in the graph's order, each output used at once;
4. the instant is recorded, and the limits are checked;
5. all other components due at t take their inputs, and then step on.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cosim.clock import seconds
from cosim.component import Array, Component
from cosim.errors import ComponentError, CosimError, GraphError, StepFailed
from cosim.graph import Graph, port, split
from cosim.interrupts import interrupts
from cosim.record import Record, Signal
from cosim.schedule import Schedule


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The run has diverged once the signal's largest element (or its Euclidean norm) is above a maximum, or its least below a
    minimum, without a break for longer than `lasting` [ns]. `elements` (first, last), counted from 1, picks a part of an array.
    """

    signal: str
    bound: float
    cause: str
    is_minimum: bool = False
    elements: tuple[int, int] | None = None
    euclidean: bool = False
    lasting: int = 0


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


Progress = Callable[[float], None]


class Pace(Protocol):
    """What ties a run's instants to the outside: both are called at every instant, before anything happens and after all has.

    `begin` gives a reason to end the run before this instant, or None.
    """

    def begin(self, k: int) -> str | None: ...

    def end(self, k: int) -> None: ...


@dataclass(frozen=True)
class _Slave:
    """One component with everything bound that a step calls."""

    component: Component
    ratio: int
    take_inputs: Callable[[], None]
    take_first_inputs: Callable[[set[str]], None]
    take_present_inputs: Callable[[], None]
    write: Callable[[], None]
    read: Callable[[], None]

    def step(self, time: float, size: float) -> None:
        try:
            self.component.step(time, size)
        except StepFailed:
            raise
        except Exception as error:  # a component written by others fails in its own ways; the run is kept all the same
            left = bool(getattr(error, "left_validity", False))
            raise StepFailed(self.component.name, told(error), left_validity=left) from error


class Master:
    """Binds a graph to its buffers; `run` may be called once."""

    def __init__(self, graph: Graph, schedule: Schedule, limits: Sequence[Limit] = ()) -> None:
        self.graph, self.schedule = graph, schedule
        self._place: dict[str, slice] = {}
        outputs: dict[str, list[str]] = {}
        signals, width = [], 0
        for name, component in graph.components.items():
            outputs[name] = [p.name for p in component.ports.values() if p.causality == "output" and p.real]
            for variable in outputs[name]:
                p = component.ports[variable]
                self._place[f"{name}.{variable}"] = slice(width, width + p.size)
                signals.append(Signal(name=f"{name}.{variable}", first=width, size=p.size, units=p.units))
                width += p.size
        # One flat vector of all outputs; `_before` is its state before the present instant, for delayed connections.
        self._now = np.zeros(width)
        self._before = np.zeros(width)
        self._has_delays = any(connection.delayed for connection in graph.connections)
        self._record_signals = signals
        self._slaves = {name: self._bind(name, outputs[name]) for name in graph.components}
        self._limits = [self._bind_limit(limit) for limit in limits]

    def initialise(self, start_values: Mapping[str, Mapping[str, Array]]) -> None:
        """Components with plant-like outputs first, so that the others are initialised with real inputs.

        An input whose source is not initialised yet keeps its own start value. Raises CosimError.
        """
        ready: set[str] = set()
        for name in (*self.graph.then, *self.graph.first):
            slave = self._slaves[name]
            try:
                slave.component.enter_initialization(0.0, start_values.get(name, {}))
                slave.take_first_inputs(ready)
                slave.write()
                slave.component.exit_initialization()
                slave.read()
            except CosimError:
                raise
            except Exception as error:
                raise ComponentError(f"component {name} cannot be initialised: {told(error)}") from error
            ready.add(name)

    def value(self, signal: str) -> Array:
        """The present value of an output, COMPONENT.VARIABLE: a view."""
        return self._now[self._place[signal]]

    def hand_over(self, name: str) -> None:
        """Give a component its inputs at the end of an instant, delayed ones too: for a `Pace` that sends commands there."""
        self._slaves[name].take_present_inputs()
        self._slaves[name].write()

    def run(self, progress: Progress | None = None, pace: Pace | None = None) -> Outcome:
        schedule = self.schedule
        record = Record(self._record_signals, schedule.ticks // schedule.record_ratio + 2)
        outcome = Outcome(record=record, simulated=0.0, wall=0.0, steps=dict.fromkeys(self._slaves, 0))
        begin = time.perf_counter()
        k = 0
        with interrupts() as interrupted:
            try:
                for k in range(schedule.ticks + 1):
                    outcome.cause = pace.begin(k) if pace else None
                    if outcome.cause:
                        break
                    outcome.interrupted = bool(interrupted)
                    cause = self._instant(k, outcome, last=outcome.interrupted or k == schedule.ticks)
                    if cause:
                        outcome.diverged, outcome.cause = True, cause
                        break
                    if outcome.interrupted:
                        outcome.cause = "interrupted by the user"
                        break
                    if progress and k % 1000 == 0:
                        progress(seconds(k * schedule.tick))
                    if pace:
                        pace.end(k)
            except StepFailed as error:
                if k == 0 and not error.left_validity and pace is None:
                    raise ComponentError(f"component {error}") from error
                outcome.diverged, outcome.failed, outcome.cause = error.left_validity, not error.left_validity, str(error)
        outcome.wall = time.perf_counter() - begin
        outcome.simulated = seconds(k * schedule.tick)
        if record.rows == 0 or record.time[-1] < outcome.simulated:
            record.append(outcome.simulated, self._now)
        return outcome

    def _instant(self, k: int, outcome: Outcome, *, last: bool) -> str | None:
        """Everything that happens at tick k; at the last one nobody steps on. A cause if a limit is passed."""
        schedule, graph, slaves = self.schedule, self.graph, self._slaves
        moment = seconds(k * schedule.tick)
        if self._has_delays:
            self._before[:] = self._now
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
                    slave.step(moment, seconds(schedule.size(name, k)))
                    slave.read()
                    outcome.steps[name] += 1
        if k % schedule.record_ratio == 0:
            outcome.record.append(moment, self._now)
        for check in self._limits:
            cause = check()
            if cause:
                return cause
        if last:
            return None
        due = [name for name in graph.then if k % slaves[name].ratio == 0]
        for name in due:
            slaves[name].take_inputs()
            slaves[name].write()
        for name in due:
            slaves[name].step(moment, seconds(schedule.size(name, k)))
            outcome.steps[name] += 1
        return None

    # Binding

    def _bind(self, name: str, outputs: Sequence[str]) -> _Slave:
        component, connections = self.graph.components[name], self.graph.inputs_of(name)
        targets = [split(connection.target)[1] for connection in connections]
        # Every input begins with its own start value.
        starts = [np.array(component.ports[target].start or [0.0] * component.ports[target].size) for target in targets]
        buffer = np.concatenate([np.zeros(0), *starts])
        prompt: tuple[list[int], list[int]] = ([], [])
        delayed: tuple[list[int], list[int]] = ([], [])
        first_time: list[tuple[str, slice, slice]] = []
        first = 0
        for connection, start in zip(connections, starts, strict=True):
            place, there = self._place[connection.source], slice(first, first + start.size)
            into, sources = delayed if connection.delayed else prompt
            into += range(there.start, there.stop)
            sources += range(place.start, place.stop)
            first_time.append((split(connection.source)[0], there, place))
            first = there.stop
        now, before = self._now, self._before
        (p_to, p_from), (d_to, d_from) = (tuple(np.array(part, dtype=int) for part in pair) for pair in (prompt, delayed))

        def take_inputs() -> None:
            if p_to.size:
                buffer[p_to] = now[p_from]
            if d_to.size:
                buffer[d_to] = before[d_from]

        def take_first_inputs(ready: set[str]) -> None:
            for source, there, place in first_time:
                if source in ready:
                    buffer[there] = now[place]

        def take_present_inputs() -> None:
            if p_to.size:
                buffer[p_to] = now[p_from]
            if d_to.size:
                buffer[d_to] = now[d_from]

        write = component.bind_inputs(targets, buffer) if targets else _nothing
        own = [self._place[f"{name}.{variable}"] for variable in outputs]
        read = component.bind_outputs(outputs, now[own[0].start : own[-1].stop]) if own else _nothing
        return _Slave(component, self.schedule.ratios[name], take_inputs, take_first_inputs, take_present_inputs, write, read)

    def _bind_limit(self, limit: Limit) -> Callable[[], str | None]:
        if limit.signal not in self._place:
            port(self.graph.components, limit.signal, "limit")
            raise GraphError(f"limit: {limit.signal} is not a real output")
        place = self._place[limit.signal]
        first, last = limit.elements or (1, place.stop - place.start)
        if last > place.stop - place.start:
            raise GraphError(
                f"limit on {limit.signal}: elements {first} to {last} are watched, but it has {place.stop - place.start}"
            )
        view = self._now[place.start + first - 1 : place.start + last]
        square = limit.bound**2
        patience = limit.lasting // self.schedule.tick

        def check_maximum() -> str | None:
            # The Euclidean norm bounds the largest element: one product decides the common case; NaN fails it.
            if view @ view <= square:
                return None
            size = float(np.linalg.norm(view) if limit.euclidean else np.abs(view).max())
            if size <= limit.bound:
                return None
            return f"{limit.cause}: {limit.signal} is {size:.4g}, the limit is {limit.bound:g}"

        def check_minimum() -> str | None:
            least = float(view.min())
            if least >= limit.bound:
                return None
            return f"{limit.cause}: {limit.signal} is {least:.4g}, the least allowed is {limit.bound:g}"

        check = check_minimum if limit.is_minimum else check_maximum
        if not patience:
            return check
        passed = 0

        def check_lasting() -> str | None:
            nonlocal passed
            cause = check()
            passed = passed + 1 if cause else 0
            return f"{cause}, for {seconds(limit.lasting):g} s" if passed > patience else None

        return check_lasting


def told(error: Exception) -> str:
    """One sentence for an exception of somebody else's component: its own if it knows of us, else with kind and place."""
    if hasattr(error, "left_validity"):
        return " ".join(str(error).split())
    place = traceback.extract_tb(error.__traceback__)[-1]
    return " ".join(f"{type(error).__name__}: {error} ({place.filename}, line {place.lineno})".split())


def _nothing() -> None:
    pass
