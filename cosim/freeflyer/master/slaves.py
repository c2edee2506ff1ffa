"""Buffers for the components of a graph.

One flat vector contains all outputs. Each component has its own buffer for inputs. A slave is a
component with its buffers.
"""

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
    """Connected values from the component `source` to one slave.

    Each value is copied: buffer[into[i]] = outputs[places[i]]. Here, `outputs` is the vector of all
    outputs.
    """

    source: str
    delayed: bool
    into: Places
    places: Places


class Slave:
    """A component with its buffers.

    `buffer` contains the connected inputs one after the other. `targets` are the variables of these
    inputs. `view` contains the outputs. The first `used` variables among the outputs are those that
    connections and limits need at every step.
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
        # An input has the start value of its port until the value of a source is copied.
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
        """Copy the source values of all connections to the buffer."""
        into, places = self._prompt
        if into.size:
            self.buffer[into] = self._now[places]
        into, places = self._delayed
        if into.size:
            self.buffer[into] = self._before[places]

    def take_first_inputs(self, ready: set[str]) -> None:
        """Copy the source values from the components that are initialised (`ready`)."""
        for wire in self.wires:
            if wire.source in ready:
                self.buffer[wire.into] = self._now[wire.places]

    def take_present_inputs(self) -> None:
        """Copy the present source values of all connections, including delayed connections."""
        for wire in self.wires:
            self.buffer[wire.into] = self._now[wire.places]


class Slaves:
    """All slaves by name.

    `now` is the flat vector of all outputs. `before` has the same layout. `before` contains the
    values from before the present instant, but only for the sources of delayed connections.
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
        """Copy the source values of the delayed connections from `now` to `before`."""
        if self.delayed.size:
            self.before[self.delayed] = self.now[self.delayed]

    def value(self, signal: str) -> Array:
        """Return a view of the present value of an output."""
        return self.now[self.places[signal]]

    def signals(self, graph: Graph, recorded: Callable[[str], bool]) -> tuple[list[Signal], Places]:
        """Return the signals of the record, and the index in `now` of each column of the record.

        The signals have the order of the components and of the ports.
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
    """Return the outputs of a component. Outputs that are used come first.

    With this order, the outputs that are used can be read without the other outputs.
    """
    found = [
        port.name for port in component.ports.values() if port.causality == "output" and port.real
    ]
    return sorted(found, key=lambda variable: f"{name}.{variable}" not in used)


def _nothing() -> None:
    pass
