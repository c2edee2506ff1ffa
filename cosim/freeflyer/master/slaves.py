"""Buffers of a graph's components: one flat vector of all outputs, and the inputs of each slave."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from freeflyer.fmi.component import Array, Component
from freeflyer.foundation.signal_name import split
from freeflyer.master.graph import Graph
from freeflyer.master.record import Signal

Places = NDArray[np.int64]


@dataclass(frozen=True)
class Wires:
    """Connections from component `source` to one slave: buffer[into[i]] = outputs[places[i]]."""

    source: str
    delayed: bool
    into: Places
    places: Places


class Slave:
    """A component with its buffers.

    `buffer` contains its connected inputs, the variables `targets`, one after the other. `view`
    contains its outputs; connections and limits need the first `used` variables at every step.
    """

    def __init__(
        self,
        component: Component,
        ratio: int,
        targets: Sequence[str],
        wires: Sequence[Wires],
        outputs: Sequence[str],
        used: int,
        now: Array,
        before: Array,
        own: slice,
    ) -> None:
        self.component, self.ratio = component, ratio
        self.targets, self.wires = targets, wires
        self.outputs, self.used, self.view = outputs, used, now[own]
        # Every input has its own start value until a source is read.
        starts = [
            np.array(component.ports[target].start or [0.0] * component.ports[target].size)
            for target in targets
        ]
        self.buffer = np.concatenate([np.zeros(0), *starts])
        self._now, self._before = now, before
        self._prompt, self._delayed = (
            tuple(
                np.concatenate(
                    [
                        np.zeros(0, dtype=np.int64),
                        *(getattr(wire, end) for wire in wires if wire.delayed == delayed),
                    ]
                )
                for end in ("into", "places")
            )
            for delayed in (False, True)
        )

    @cached_property
    def write(self) -> Callable[[], None]:
        """Function that writes the buffer to the component's inputs."""
        return self.component.bind_inputs(self.targets, self.buffer) if self.targets else _nothing

    @cached_property
    def read(self) -> Callable[[], None]:
        """Function that reads all outputs of the component into `view`."""
        return self.component.bind_outputs(self.outputs, self.view) if self.outputs else _nothing

    def take_inputs(self) -> None:
        """Copy the sources of all connections to the buffer."""
        into, places = self._prompt
        if into.size:
            self.buffer[into] = self._now[places]
        into, places = self._delayed
        if into.size:
            self.buffer[into] = self._before[places]

    def take_first_inputs(self, ready: set[str]) -> None:
        """Copy only the sources in initialised components."""
        for wire in self.wires:
            if wire.source in ready:
                self.buffer[wire.into] = self._now[wire.places]

    def take_present_inputs(self) -> None:
        """Copy the present values of all sources, also those of delayed connections."""
        for wire in self.wires:
            self.buffer[wire.into] = self._now[wire.places]


class Slaves:
    """All slaves by name.

    `now` is the flat vector of all outputs, `before` its value before the present instant.
    """

    def __init__(
        self, graph: Graph, ratios: Mapping[str, int], watched: Sequence[str] = ()
    ) -> None:
        used = {connection.source for connection in graph.connections} | set(watched)
        outputs = {
            name: _outputs(name, component, used) for name, component in graph.components.items()
        }
        self.places: dict[str, slice] = {}
        width = 0
        for name, component in graph.components.items():
            for variable in outputs[name]:
                size = component.ports[variable].size
                self.places[f"{name}.{variable}"] = slice(width, width + size)
                width += size
        self.now, self.before = np.zeros(width), np.zeros(width)
        delayed = [connection.source for connection in graph.connections if connection.delayed]
        self.delayed = np.unique(
            np.concatenate(
                [np.zeros(0, dtype=np.int64), *(self._range(signal) for signal in delayed)]
            )
        )
        self._by_name = {
            name: self._bind(graph, name, outputs[name], ratios[name], used)
            for name in graph.components
        }

    def __getitem__(self, name: str) -> Slave:
        return self._by_name[name]

    def keep_delayed(self) -> None:
        """Store the sources of the delayed connections."""
        if self.delayed.size:
            self.before[self.delayed] = self.now[self.delayed]

    def value(self, signal: str) -> Array:
        """Return a view of the present value of an output."""
        return self.now[self.places[signal]]

    def signals(self, graph: Graph, recorded: Callable[[str], bool]) -> tuple[list[Signal], Places]:
        """Return the record's signals and the places of their columns in `now`.

        Signals have the order of the components and their ports.
        """
        signals, columns = [], [np.zeros(0, dtype=np.int64)]
        first = 0
        for name, component in graph.components.items():
            for variable, port in component.ports.items():
                signal = f"{name}.{variable}"
                if signal in self.places and recorded(signal):
                    signals.append(
                        Signal(name=signal, first=first, size=port.size, units=port.units)
                    )
                    columns.append(self._range(signal))
                    first += port.size
        return signals, np.concatenate(columns)

    def _range(self, signal: str) -> Places:
        place = self.places[signal]
        return np.arange(place.start, place.stop)

    def _bind(
        self, graph: Graph, name: str, outputs: Sequence[str], ratio: int, used: set[str]
    ) -> Slave:
        component, connections = graph.components[name], graph.inputs_of(name)
        targets = [split(connection.target)[1] for connection in connections]
        wires, first = [], 0
        for connection, target in zip(connections, targets, strict=True):
            last = first + component.ports[target].size
            source = split(connection.source)[0]
            wires.append(
                Wires(
                    source,
                    connection.delayed,
                    np.arange(first, last),
                    self._range(connection.source),
                )
            )
            first = last
        own = [self.places[f"{name}.{variable}"] for variable in outputs]
        part = slice(own[0].start, own[-1].stop) if own else slice(0, 0)
        needed = sum(f"{name}.{variable}" in used for variable in outputs)
        return Slave(component, ratio, targets, wires, outputs, needed, self.now, self.before, part)


def _outputs(name: str, component: Component, used: set[str]) -> list[str]:
    """Return the outputs of a component, those in use first, so that these can be read alone."""
    found = [
        port.name for port in component.ports.values() if port.causality == "output" and port.real
    ]
    return sorted(found, key=lambda variable: f"{name}.{variable}" not in used)


def _nothing() -> None:
    pass
