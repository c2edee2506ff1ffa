"""The master: steps the components of a graph on a multi-rate schedule, and records.

At an instant t:
1. delayed connections keep what their sources had before t;
2. components whose last step ends at t hand over their outputs of t;
3. controllers due at t sample and answer, in the graph's order, each output used at once;
4. the instant is recorded, and the limits are checked;
5. all other components due at t take their inputs, and then step on.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from cosim.clock import seconds
from cosim.component import Array, Component
from cosim.errors import ComponentError, CosimError, GraphError, StepFailed
from cosim.graph import Graph, port, split
from cosim.record import Record, Signal
from cosim.schedule import Schedule


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The run has diverged once the signal's largest element (or its Euclidean norm) is beyond `maximum`."""

    signal: str
    maximum: float
    cause: str
    first: int = 1
    last: int | None = None
    euclidean: bool = False


@dataclass(kw_only=True)
class Outcome:
    """How a run ended. `cause` says why it stopped before its time."""

    record: Record
    simulated: float
    wall: float
    steps: dict[str, int]
    diverged: bool = False
    cause: str | None = None
    interrupted: bool = False


Progress = Callable[[float], None]


@dataclass(frozen=True)
class _Slave:
    """One component with everything bound that a step calls."""

    component: Component
    ratio: int
    take_inputs: Callable[[], None]
    write: Callable[[], None]
    read: Callable[[], None]

    def step(self, time: float, size: float) -> None:
        try:
            self.component.step(time, size)
        except StepFailed:
            raise
        except Exception as error:  # a component written by others fails in its own ways; the run is kept all the same
            raise StepFailed(self.component.name, str(error) or type(error).__name__) from error


class Master:
    """Binds a graph to its buffers; `run` may be called once."""

    def __init__(self, graph: Graph, schedule: Schedule, limits: Sequence[Limit] = ()) -> None:
        self.graph, self.schedule = graph, schedule
        self._place: dict[str, slice] = {}
        outputs: dict[str, list[str]] = {}
        signals, width = [], 0
        for name, component in graph.components.items():
            outputs[name] = [p.name for p in component.ports.values() if p.causality == "output"]
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
        """Components with plant-like outputs first, so that the others are initialised with real inputs."""
        for name in (*self.graph.then, *self.graph.first):
            slave = self._slaves[name]
            try:
                slave.component.enter_initialization(0.0, start_values.get(name, {}))
                slave.take_inputs()
                slave.write()
                slave.component.exit_initialization()
                slave.read()
            except CosimError:
                raise
            except Exception as error:
                raise ComponentError(f"component {name} cannot be initialised: {error}") from error

    def run(self, progress: Progress | None = None) -> Outcome:
        schedule = self.schedule
        record = Record(self._record_signals, schedule.ticks // schedule.record_ratio + 2)
        outcome = Outcome(record=record, simulated=0.0, wall=0.0, steps=dict.fromkeys(self._slaves, 0))
        begin = time.perf_counter()
        k = 0
        with _interrupts() as interrupted:
            try:
                for k in range(schedule.ticks + 1):
                    if interrupted:
                        outcome.interrupted, outcome.cause = True, "interrupted by the user"
                        break
                    cause = self._instant(k, outcome)
                    if cause:
                        outcome.diverged, outcome.cause = True, cause
                        break
                    if progress and k % 1000 == 0:
                        progress(seconds(k * schedule.tick))
            except StepFailed as error:
                outcome.diverged, outcome.cause = True, str(error)
        outcome.wall = time.perf_counter() - begin
        outcome.simulated = seconds(k * schedule.tick)
        if record.rows == 0 or record.time[-1] < outcome.simulated:
            record.append(outcome.simulated, self._now)
        return outcome

    def _instant(self, k: int, outcome: Outcome) -> str | None:
        """Everything that happens at tick k; a cause if a limit is passed."""
        schedule, graph, slaves = self.schedule, self.graph, self._slaves
        moment, over = seconds(k * schedule.tick), k == schedule.ticks
        if self._has_delays:
            self._before[:] = self._now
        if k:
            for name in graph.then:
                if k % slaves[name].ratio == 0 or over:
                    slaves[name].read()
        if not over:
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
        if over:
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
        buffer = np.zeros(sum(component.ports[target].size for target in targets))
        prompt: tuple[list[int], list[int]] = ([], [])
        delayed: tuple[list[int], list[int]] = ([], [])
        first = 0
        for connection, target in zip(connections, targets, strict=True):
            place, size = self._place[connection.source], component.ports[target].size
            into, sources = delayed if connection.delayed else prompt
            into += range(first, first + size)
            sources += range(place.start, place.stop)
            first += size
        now, before = self._now, self._before
        (p_to, p_from), (d_to, d_from) = (tuple(map(np.array, pair)) for pair in (prompt, delayed))

        def take_inputs() -> None:
            if p_to.size:
                buffer[p_to] = now[p_from]
            if d_to.size:
                buffer[d_to] = before[d_from]

        write = component.bind_inputs(targets, buffer) if targets else _nothing
        own = [self._place[f"{name}.{variable}"] for variable in outputs]
        read = component.bind_outputs(outputs, now[own[0].start : own[-1].stop]) if own else _nothing
        return _Slave(component, self.schedule.ratios[name], take_inputs, write, read)

    def _bind_limit(self, limit: Limit) -> Callable[[], str | None]:
        if limit.signal not in self._place:
            port(self.graph.components, limit.signal, "limit")
            raise GraphError(f"limit: {limit.signal} is not an output")
        place = self._place[limit.signal]
        last = limit.last if limit.last is not None else place.stop - place.start
        view = self._now[place.start + limit.first - 1 : place.start + last]
        square = limit.maximum**2

        def check() -> str | None:
            # The Euclidean norm bounds the largest element: one product decides the common case; NaN fails it.
            if view @ view <= square:
                return None
            size = float(np.linalg.norm(view) if limit.euclidean else np.abs(view).max())
            if size <= limit.maximum:
                return None
            return f"{limit.cause}: {limit.signal} is {size:.4g}, the limit is {limit.maximum:g}"

        return check


def _nothing() -> None:
    pass


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Ctrl-C as a list that fills, so that a run ends between two instants; a second one interrupts for good."""
    seen: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield seen
        return

    def note(number: int, frame: object) -> None:
        if seen:
            raise KeyboardInterrupt
        seen.append(number)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, before)
